// Decodes a .drc of Strata off the page's thread. Layout: docs/draco-output.md.
import wasmAddress from 'draco3d/draco_decoder.wasm?url';
import createDecoder from 'draco3d/draco_decoder_nodejs.js';

const ready = fetch(wasmAddress)
                  .then((response) => response.arrayBuffer())
                  .then((wasmBinary) => createDecoder({wasmBinary}));

/** The values of the attribute that has this name in its metadata, or null. */
function readAttribute(draco, decoder, cloud, name, ArrayType) {
  const id = decoder.GetAttributeIdByMetadataEntry(cloud, 'name', name);
  if (id < 0) return null;
  const attribute = decoder.GetAttribute(cloud, id);
  const count = cloud.num_points() * attribute.num_components();
  const size = count * ArrayType.BYTES_PER_ELEMENT;
  const type = ArrayType === Int32Array ? draco.DT_INT32 : draco.DT_FLOAT32;
  const at = draco._malloc(size);
  try {
    if (!decoder.GetAttributeDataArrayForAllPoints(cloud, attribute, type, size, at)) {
      throw new Error(`the attribute ${name} cannot be read`);
    }
    // The heap may have moved while Draco allocated, so its buffer is asked for only now.
    return new ArrayType(draco.HEAPU8.buffer, at, count).slice();
  } finally {
    draco._free(at);
  }
}

/** Three arrays of one component as one of three. */
function interleave(columns) {
  const joined = new Int32Array(columns[0].length * 3);
  columns.forEach((column, axis) => column.forEach((value, i) => joined[3 * i + axis] = value));
  return joined;
}

function readOffset(draco, decoder, cloud) {
  const querier = new draco.MetadataQuerier();
  const metadata = decoder.GetMetadata(cloud);
  try {
    return ['x', 'y', 'z'].map(
        (axis) => querier.GetDoubleEntry(metadata, `position_offset_${axis}`));
  } finally {
    draco.destroy(querier);
  }
}

function readCloud(draco, decoder, cloud) {
  const read = (name, ArrayType) => readAttribute(draco, decoder, cloud, name, ArrayType);
  const cells = ['cell_x', 'cell_y', 'cell_z'].map((name) => read(name, Int32Array));
  return {
    count: cloud.num_points(),
    offset: readOffset(draco, decoder, cloud),
    position: read('position', Float32Array),
    normal: read('normal', Float32Array),
    cell: cells.every(Boolean) ? interleave(cells) : null,
    area: read('area', Float32Array),
  };
}

function decode(draco, bytes) {
  const decoder = new draco.Decoder();
  const cloud = new draco.PointCloud();
  try {
    const status = decoder.DecodeArrayToPointCloud(new Int8Array(bytes), bytes.byteLength, cloud);
    if (!status.ok()) throw new Error(`Draco: ${status.error_msg()}`);
    return readCloud(draco, decoder, cloud);
  } finally {
    draco.destroy(cloud);
    draco.destroy(decoder);
  }
}

self.onmessage = async ({data: {id, bytes}}) => {
  try {
    const samples = decode(await ready, bytes);
    const arrays = [samples.position, samples.normal, samples.cell, samples.area];
    self.postMessage({id, result: samples}, arrays.filter(Boolean).map((array) => array.buffer));
  } catch (error) {
    self.postMessage({id, error: String(error.message ?? error)});
  }
};

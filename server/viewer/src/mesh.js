// Reads a mesh in the browser, to draw it. The samples on screen never depend on this: they are the
// server's.
import {BufferAttribute, BufferGeometry} from 'three';
import {OBJLoader} from 'three/addons/loaders/OBJLoader.js';
import {PLYLoader} from 'three/addons/loaders/PLYLoader.js';
import {STLLoader} from 'three/addons/loaders/STLLoader.js';

/** Larger files are sampled but not drawn: the page would stand still for seconds. */
export const MOST_BYTES = 96 << 20;

async function unpacked(file) {
  const head = new Uint8Array(await file.slice(0, 2).arrayBuffer());
  if (head[0] !== 0x1f || head[1] !== 0x8b) return file;
  return new Response(file.stream().pipeThrough(new DecompressionStream('gzip'))).blob();
}

/** By content, as the server does; only OBJ has no mark and is told by the name. */
async function formatOf(file, name) {
  const head = new DataView(await file.slice(0, 84).arrayBuffer());
  const text = new TextDecoder('latin1').decode(head.buffer.slice(0, 5));
  if (/^ply\s/.test(text)) return 'ply';
  if (head.byteLength === 84 && 84 + 50 * head.getUint32(80, true) === file.size) return 'stl';
  if (text === 'solid') return 'stl';
  return /\.obj(\.gz)?$/i.test(name) ? 'obj' : '';
}

/** All triangles of a loader's answer as corners, nine numbers a triangle. */
function cornersOf(object) {
  const parts = [];
  if (object.isBufferGeometry)
    parts.push(object);
  else
    object.traverse((child) => child.isMesh && parts.push(child.geometry));
  const flat =
      parts.map((part) => (part.index ? part.toNonIndexed() : part).attributes.position.array);
  const corners = new Float32Array(flat.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of flat) {
    corners.set(part, at);
    at += part.length;
  }
  return corners;
}

async function parse(file, format) {
  switch (format) {
    case 'ply': {
      const geometry = new PLYLoader().parse(await file.arrayBuffer());
      return geometry.index ? geometry : null;  // Without faces there is nothing to draw.
    }
    case 'stl':
      return new STLLoader().parse(await file.arrayBuffer());
    case 'obj':
      return new OBJLoader().parse(await file.text());
    default:
      return null;
  }
}

/**
 * @param {Blob} file
 * @param {string} name
 * @returns {Promise<{geometry: BufferGeometry}|null>} null: not one that the page reads (or that is
 *     well-formed); the server then says what is wrong, if anything is
 */
export async function readMesh(file, name) {
  try {
    if (file.size > MOST_BYTES) return null;
    const plain = await unpacked(file);
    if (plain.size > MOST_BYTES) return null;
    const parsed = await parse(plain, await formatOf(plain, name));
    const corners = parsed && cornersOf(parsed);
    if (!corners?.length || !corners.every(Number.isFinite)) return null;
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(corners, 3));
    geometry.computeVertexNormals();
    geometry.computeBoundingBox();
    return {geometry};
  } catch {
    return null;
  }
}

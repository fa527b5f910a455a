// A colour for each sample.

/** Corners of the ramp from little to much: dark blue to yellow, in even steps of lightness. */
const RAMP = [
  [0.267, 0.005, 0.329], [0.229, 0.322, 0.546], [0.128, 0.567, 0.551], [0.369, 0.789, 0.383],
  [0.993, 0.906, 0.144]
];

/** @param {number} share 0 to 1 */
export function rampColour(share) {
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const i = Math.min(Math.floor(at), RAMP.length - 2);
  return RAMP[i].map((low, k) => low + (at - i) * (RAMP[i + 1][k] - low));
}

/** A hue that neighbouring cells do not share. */
function cellColour(x, y, z) {
  let hash = Math.imul(x, 0x8da6b343) ^ Math.imul(y, 0xd8163841) ^ Math.imul(z, 0xcb1ab31f);
  hash = Math.imul(hash ^ (hash >>> 15), 0x2c1b3c6d);
  const hue = ((hash >>> 8) & 0xffff) / 0x10000 * 6;
  return [5, 3, 1].map(
      (k) => 0.25 + 0.6 * Math.max(0, Math.min(1, Math.abs((hue + k) % 6 - 3) - 1)));
}

/** The largest piece that a plane cuts out of a cell of edge 1; only a folded surface has more. */
const MOST_AREA = Math.SQRT2;

/**
 * Three numbers of 0 to 1 a sample.
 * @param {object} samples as the Draco worker gives them
 * @param {'normal'|'cell'|'area'} mode one that the samples lack is shown as grey
 * @param {{origin: number[], edge: number}} lattice
 */
export function coloursOf(samples, mode, lattice) {
  const colours = new Float32Array(3 * samples.count).fill(0.6);
  const paint = (colour) => {
    for (let i = 0; i < samples.count; ++i) colours.set(colour(i), 3 * i);
  };
  const {normal, area, position, offset} = samples;
  if (mode === 'normal' && normal) {
    paint((i) => [0, 1, 2].map((axis) => 0.5 + 0.5 * normal[3 * i + axis]));
  } else if (mode === 'area' && area) {
    paint((i) => rampColour(area[i] / (lattice.edge ** 2 * MOST_AREA)));
  } else if (mode === 'cell') {
    const index = (i, axis) => samples.cell ?
        samples.cell[3 * i + axis] :
        Math.floor((position[3 * i + axis] + offset[axis] - lattice.origin[axis]) / lattice.edge);
    paint((i) => cellColour(index(i, 0), index(i, 1), index(i, 2)));
  }
  return colours;
}

// Uniform samples of a mesh, to stand beside the stratified ones: a triangle with a chance in
// proportion to its area, then a uniform point of it.

/** mulberry32: repeatable, and good enough for a picture. */
export function randomFrom(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

/** Twice the triangle's area as a vector along its normal. */
function crossOf(c, t) {
  const ux = c[t + 3] - c[t], uy = c[t + 4] - c[t + 1], uz = c[t + 5] - c[t + 2];
  const vx = c[t + 6] - c[t], vy = c[t + 7] - c[t + 1], vz = c[t + 8] - c[t + 2];
  return [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
}

/** The sums of the areas (doubled) of triangles 0 to i. */
function cumulativeAreas(corners) {
  const sums = new Float64Array(corners.length / 9);
  let sum = 0;
  for (let i = 0; i < sums.length; ++i) sums[i] = sum += Math.hypot(...crossOf(corners, 9 * i));
  return sums;
}

/** The first index whose sum is above `value`. */
function firstAbove(sums, value) {
  let low = 0, high = sums.length - 1;
  while (low < high) {
    const middle = (low + high) >>> 1;
    if (sums[middle] > value)
      high = middle;
    else
      low = middle + 1;
  }
  return low;
}

/**
 * @param {Float32Array} corners nine numbers a triangle
 * @param {number} count
 * @param {number} seed
 * @returns {{count: number, offset: number[], position: Float32Array, normal: Float32Array,
 *            cell: null, area: null}|null} null: the mesh has no area
 */
export function uniformSamples(corners, count, seed) {
  const sums = cumulativeAreas(corners);
  const total = sums.at(-1);
  if (!(total > 0)) return null;
  const random = randomFrom(seed);
  const position = new Float32Array(3 * count), normal = new Float32Array(3 * count);
  for (let i = 0; i < 3 * count; i += 3) {
    const t = 9 * firstAbove(sums, random() * total);
    const root = Math.sqrt(random()), side = random();
    const a = 1 - root, b = root * (1 - side), c = root * side;
    const cross = crossOf(corners, t), length = Math.hypot(...cross);
    for (let axis = 0; axis < 3; ++axis) {
      position[i + axis] =
          a * corners[t + axis] + b * corners[t + 3 + axis] + c * corners[t + 6 + axis];
      normal[i + axis] = cross[axis] / length;
    }
  }
  return {count, offset: [0, 0, 0], position, normal, cell: null, area: null};
}

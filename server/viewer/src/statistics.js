// What the plots show of a set of samples. Lengths are in edges of a cell.
import {NeighbourGrid} from './neighbours.js';

const MOST_ASKED = 50000;  // Points whose nearest neighbour is looked for; an even choice of more.
const BINS = 40;
const FARTHEST = 16;    // Distances beyond are not told apart.
const LEAST_RANGE = 2;  // Of the histogram.

function histogram(distances, largest) {
  const range = Math.max(LEAST_RANGE, Math.ceil(largest * 1.01)), binWidth = range / BINS;
  const density = new Array(BINS).fill(0);
  for (const d of distances) {
    density[Math.min(BINS - 1, Math.floor(d / binWidth))] += 1 / distances.length / binWidth;
  }
  return {density, binWidth};
}

/**
 * The distances to the nearest neighbour.
 * @returns {{density: number[], binWidth: number, smallest: number, mean: number,
 *     variation: number}} density: share of the samples per edge; variation: standard deviation
 * over mean
 */
export function nearestDistances(grid, edge) {
  const count = grid.points.length, step = Math.ceil(count / MOST_ASKED);
  const distances = [];
  for (let i = 0; i < count; i += step) {
    distances.push(Math.min(grid.nearest(i, FARTHEST * edge) / edge, FARTHEST));
  }
  const sum = (f) => distances.reduce((total, d) => total + f(d), 0);
  const extreme = (pick) => distances.reduce((a, b) => pick(a, b));
  const mean = sum((d) => d) / distances.length;
  const deviation = Math.sqrt(sum((d) => (d - mean) ** 2) / distances.length);
  return {
    ...histogram(distances, extreme(Math.max)),
    smallest: extreme(Math.min),
    mean,
    variation: deviation / mean,
  };
}

// --- Flat patches --------------------------------------------------------------------------------

const RADII = [32, 24, 16, 12, 9, 7];  // Of a patch, in edges: the largest that is flat is taken.
const TRIED = 150;                     // Samples tried as the middle of a patch.
const MOST_PATCHES = 6;
const MOST_IN_PATCH = 3000;
const LEAST_IN_PATCH = 100;
const FLAT_COSINE = 0.95;  // Between normals: 18 degrees.
const FLAT_HEIGHT = 1;     // From the plane, in edges.

const dot = (a, i, b, j) => a[i] * b[j] + a[i + 1] * b[j + 1] + a[i + 2] * b[j + 2];

/** The samples within `reach` of sample i, if they lie flat; else null. */
function flatAround({position, normal}, grid, i, reach, edge) {
  const members = [i];
  let flat = true;
  grid.visit(i, reach, (j) => {
    const along = [0, 1, 2].map((axis) => position[3 * j + axis] - position[3 * i + axis]);
    const height = Math.abs(dot(along, 0, normal, 3 * i));
    flat = dot(normal, 3 * i, normal, 3 * j) > FLAT_COSINE && height < FLAT_HEIGHT * edge;
    members.push(j);
    return flat;
  });
  return flat ? members : null;
}

/** The members of a patch as points of the plane, in edges, the middle at (0, 0). */
function flatten({position, normal}, members, edge) {
  const i = 3 * members[0];
  const n = [normal[i], normal[i + 1], normal[i + 2]];
  const helper = Math.abs(n[0]) < 0.6 ? [1, 0, 0] : [0, 1, 0];
  const cross =
      (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const raw = cross(n, helper), length = Math.hypot(...raw);
  const u = raw.map((x) => x / length), v = cross(n, u);
  return members.map((j) => {
    const along = [0, 1, 2].map((axis) => (position[3 * j + axis] - position[i + axis]) / edge);
    return [dot(along, 0, u, 0), dot(along, 0, v, 0)];
  });
}

/**
 * Patches that share no sample: {reach, points}, reach in edges.
 */
export function flatPatches(samples, edge) {
  const patches = [];
  const taken = new Set();
  for (const reach of RADII) {
    const grid = new NeighbourGrid(samples.position, reach * edge / 3);
    // Visiting a large ball costs its area, so fewer are tried.
    const tried = Math.min(TRIED, Math.ceil(TRIED * 150 / reach ** 2));
    const step = Math.max(1, Math.floor(samples.count / tried));
    for (let i = 0; i < samples.count && patches.length < MOST_PATCHES; i += step) {
      if (taken.has(i)) continue;
      const members = flatAround(samples, grid, i, reach * edge, edge);
      if (!members || members.length < LEAST_IN_PATCH || members.length > MOST_IN_PATCH) continue;
      // A disc that is not full would show the shape of its hole.
      if (members.length < 0.5 * Math.PI * reach ** 2 * 0.6) continue;
      if (members.some((j) => taken.has(j))) continue;
      members.forEach((j) => taken.add(j));
      patches.push({reach, points: flatten(samples, members, edge)});
    }
    if (patches.length >= MOST_PATCHES) break;
  }
  return patches;
}

// --- Spectrum ------------------------------------------------------------------------------------

const FREQUENCIES = 60, HIGHEST = 3;  // In 1 / edge.
const ANGLES = 36;

/** Power of a patch's periodogram at a radial frequency, averaged over angles; 1 = white noise. */
function radialPower({reach, points}, weights, frequency) {
  const squares = weights.reduce((sum, w) => sum + w * w, 0);
  let power = 0;
  for (let a = 0; a < ANGLES; ++a) {
    const fx = 2 * Math.PI * frequency * Math.cos(Math.PI * a / ANGLES);
    const fy = 2 * Math.PI * frequency * Math.sin(Math.PI * a / ANGLES);
    let re = 0, im = 0;
    for (let k = 0; k < points.length; ++k) {
      const phase = fx * points[k][0] + fy * points[k][1];
      re += weights[k] * Math.cos(phase);
      im += weights[k] * Math.sin(phase);
    }
    power += (re * re + im * im) / squares;
  }
  return power / ANGLES;
}

/** A disc's taper: without one its rim would leak into all frequencies. */
function taperOf({reach, points}) {
  return points.map(
      ([x, y]) => 0.5 + 0.5 * Math.cos(Math.PI * Math.min(1, Math.hypot(x, y) / reach)));
}

/**
 * The radially averaged power spectrum of flat patches.
 * @returns {{frequency: number[], power: number[], samples: number, patches: number}|null} null: no
 *     part of the samples is flat enough
 */
export function radialSpectrum(patches) {
  if (!patches.length) return null;
  const tapers = patches.map(taperOf);
  const samples = patches.reduce((sum, patch) => sum + patch.points.length, 0);
  // Below this the taper's own spectrum would show, not the samples'.
  const lowest = 2 / Math.min(...patches.map((patch) => patch.reach));
  const frequency = [], power = [];
  for (let i = 1; i <= FREQUENCIES; ++i) {
    const f = HIGHEST * i / FREQUENCIES;
    if (f < lowest) continue;
    frequency.push(f);
    power.push(patches.reduce(
        (sum, patch, k) => sum + patch.points.length / samples * radialPower(patch, tapers[k], f),
        0));
  }
  return {frequency, power, samples, patches: patches.length};
}

/** Both, of samples as the Draco worker gives them. */
export function statisticsOf(samples, edge) {
  if (samples.count < 2) return {nearest: null, spectrum: null};
  const grid = new NeighbourGrid(samples.position, edge);
  return {
    nearest: nearestDistances(grid, edge),
    spectrum: samples.normal ? radialSpectrum(flatPatches(samples, edge)) : null,
  };
}

// What needs no browser: the texts that repeat a request, statistics.
import assert from 'node:assert/strict';
import {test} from 'node:test';

import {NeighbourGrid} from '../src/neighbours.js';
import {commandLine, curlLine, outputName, queryOf, shellWord, uniformOptions} from '../src/options.js';
import {randomFrom} from '../src/random.js';
import {flatPatches, nearestDistances, radialSpectrum, statisticsOf} from '../src/statistics.js';

const OPTIONS = {
  resolution: '64',
  lambda: '2.5',
  min_distance: '0.5',
  seed: '18446744073709551615',
  integrator: 'exact'
};
const SEED = 20260722;

test('the command names every option as the user set it', () => {
  assert.equal(
      commandLine('spot.obj', OPTIONS, 'ply', 'normal,area'),
      'strata sample spot.obj -o spot-samples.ply --resolution 64 --lambda 2.5 --min-distance 0.5 ' +
          '--seed 18446744073709551615 --integrator exact --attributes normal,area');
});

test('the request names the same options in the words of the wire', () => {
  const line = curlLine('spot.obj', OPTIONS, 'drc', 'none', {origin: 'http://h:1', key: true});
  assert.match(
      line, /^curl --fail-with-body -H "Authorization: Bearer \$STRATA_KEY" -X POST -T spot/);
  assert.ok(line.includes(`'http://h:1/v1/samples?${queryOf(OPTIONS, 'drc', 'none')}'`), line);
  assert.match(line, /min_distance=0\.5&seed=18446744073709551615/);
});

test('uniform samples are repeated by their number, lattice and seed', () => {
  const options = uniformOptions(OPTIONS, 1234);
  assert.equal(
      commandLine('spot.obj', options, 'ply', 'none'),
      'strata sample spot.obj -o spot-uniform.ply --method uniform --count 1234 --resolution 64 ' +
          '--seed 18446744073709551615 --attributes none');
  assert.equal(
      queryOf(options, 'drc', 'normal'),
      'method=uniform&count=1234&resolution=64&seed=18446744073709551615&format=drc&' +
          'attributes=normal');
});

test('the request for a stored model names it and sends nothing', () => {
  const line = curlLine('a b/+.obj', OPTIONS, 'drc', 'none', {origin: 'http://h:1', stored: true});
  assert.ok(
      line.includes(`-o +-samples.drc 'http://h:1/v1/samples?model=a%20b%2F%2B.obj&resolution=`),
      line);
  assert.doesNotMatch(line, / -T | POST /);
});

test('a file name cannot leave its word in the shell', () => {
  assert.equal(shellWord('a b;$(c)\'d'), '\'a b;$(c)\'\\\'\'d\'');
  assert.match(
      commandLine('-x.obj', OPTIONS, 'ply', 'none'), /^strata sample \.\/-x\.obj -o \.\/-x-/);
  assert.equal(outputName('dir/a.ply.gz', 'npz'), 'a-samples.npz');
});

test('the nearest distances are those of brute force', () => {
  const random = randomFrom(SEED);
  const position = Float32Array.from({length: 3 * 300}, () => random() * 4 - 2);
  const grid = new NeighbourGrid(position, 0.3);
  for (let i = 0; i < 300; ++i) {
    let best = Infinity;
    for (let j = 0; j < 300; ++j)
      if (j !== i) best = Math.min(best, grid.distance2(i, j));
    assert.equal(grid.nearest(i, 100), Math.sqrt(best), `seed ${SEED}, point ${i}`);
  }
});

/** Points of a lattice of `side` by `side`, an edge apart, moved by up to `jitter` edges. */
function lattice(side, jitter) {
  const random = randomFrom(SEED), position = new Float32Array(3 * side * side);
  for (let i = 0; i < side * side; ++i) {
    position[3 * i] = i % side + jitter * (random() - 0.5);
    position[3 * i + 1] = Math.floor(i / side) + jitter * (random() - 0.5);
  }
  const normal = Float32Array.from(position, (_, i) => i % 3 === 2 ? 1 : 0);
  return {count: side * side, position, normal};
}

test('a lattice has equal distances and power at its own frequency', () => {
  const {nearest, spectrum} = statisticsOf(lattice(60, 0.2), 1);
  assert.ok(nearest.smallest > 0.75 && nearest.variation < 0.1, JSON.stringify(nearest));
  const peak = spectrum.frequency[spectrum.power.indexOf(Math.max(...spectrum.power))];
  assert.ok(Math.abs(peak - 1) < 0.06, `peak at ${peak}`);
  const lowest = spectrum.power[0];
  assert.ok(lowest < 0.2, `power ${lowest} at ${spectrum.frequency[0]}`);
});

test('uniform points have white noise for a spectrum and Rayleigh distances', () => {
  const random = randomFrom(SEED), count = 3600;
  const position =
      Float32Array.from({length: 3 * count}, (_, i) => i % 3 === 2 ? 0 : random() * 60);
  const normal = Float32Array.from({length: 3 * count}, (_, i) => i % 3 === 2 ? 1 : 0);
  const samples = {count, position, normal};
  const grid = new NeighbourGrid(samples.position, 1);
  const {mean, variation} = nearestDistances(grid, 1);
  assert.ok(Math.abs(mean - 0.5) < 0.03, `seed ${SEED}: mean ${mean}, 1/2 for one a square edge`);
  assert.ok(Math.abs(variation - 0.5227) < 0.03, `seed ${SEED}: variation ${variation}`);
  const {power} = radialSpectrum(flatPatches(samples, 1));
  const average = power.reduce((sum, p) => sum + p) / power.length;
  assert.ok(Math.abs(average - 1) < 0.15, `seed ${SEED}: average power ${average}`);
});

test('a folded surface has no flat patch', () => {
  const samples = lattice(40, 0.2);
  for (let i = 0; i < samples.count; ++i) samples.position[3 * i + 2] = 3 * Math.sin(i % 40);
  assert.equal(statisticsOf(samples, 1).spectrum, null);
});

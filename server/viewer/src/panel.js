// What the page says beside the picture: figures, plots, problems, how to do it again.
import {commandLine, curlLine, uniformOptions} from './options.js';
import {plot} from './plot.js';

const $ = (id) => document.getElementById(id);
const whole = new Intl.NumberFormat('en', {maximumFractionDigits: 0});
const number = (value, digits = 4) => Number(value.toPrecision(digits)).toString();

/** 'empty', 'busy', 'ready' or 'failed', and what a screen reader is told of it. */
export function setState(state, text) {
  document.body.dataset.state = state;
  $('status').textContent = text;
}

/** @param {Error & {title?: string}|null} error null: there is none any more */
export function showProblem(error) {
  const box = $('problem');
  box.hidden = !error;
  box.querySelector('strong').textContent = error ? error.title ?? 'The page failed' : '';
  box.querySelector('span').textContent = error ? error.message : '';
}

/**
 * @param {object} summary what the server says, as `--summary`
 * @param {{request: number, decode: number, bytes: number, cached: boolean}} cost milliseconds,
 *     bytes
 */
export function showFigures(summary, cost) {
  const skipped = Object.values(summary.mesh.skipped).reduce((sum, n) => sum + n, 0);
  const rows = [
    ['Samples', whole.format(summary.samples.after_rejection)],
    ['Occupied cells', whole.format(summary.cells)],
    ['Edge of a cell', number(summary.lattice.edge, 6)],
    [
      'Triangles',
      whole.format(summary.mesh.triangles) + (skipped ? `, ${whole.format(skipped)} skipped` : '')
    ],
    ['Area', number(summary.mesh.area, 6)],
    ['Sampling', `${number(summary.seconds * 1000, 3)} ms${cost.cached ? ', done before' : ''}`],
    ['Request, all of it', `${whole.format(cost.request)} ms`],
    ['Decoding', `${whole.format(cost.decode)} ms`],
    ['Received', `${whole.format(cost.bytes)} bytes`],
  ];
  $('figures').replaceChildren(...rows.flatMap(([name, value]) => {
    const term = document.createElement('dt'), said = document.createElement('dd');
    term.textContent = name;
    said.textContent = value;
    said.dataset.figure = name;
    return [term, said];
  }));
}

function showDistances(all) {
  const figure = $('distances');
  const said = ({name, nearest}) => `${name}: smallest ${number(nearest.smallest, 3)}, mean ` +
      `${number(nearest.mean, 3)}, variation ${number(nearest.variation, 2)}`;
  const note = `${all.map(said).join('; ')} (lengths in edges)`;
  const series = all.map(({name, nearest: {density, binWidth}}) => ({
                           name,
                           x: density.map((_, i) => (i + 0.5) * binWidth),
                           y: density,
                         }));
  const mostX = Math.max(...all.map(({nearest}) => nearest.density.length * nearest.binWidth));
  plot(
      figure, series, {label: 'distance / edge', mostX, description: `Nearest distances. ${note}`});
  figure.querySelector('.note').textContent = note;
}

function showSpectrum(all) {
  const figure = $('spectrum'), [own] = all, note = figure.querySelector('.note');
  if (!own.spectrum) {
    figure.querySelector('.plot').replaceChildren();
    note.textContent =
        'No part of the surface is flat over 100 samples: a finer resolution may help.';
    return;
  }
  const {patches, samples} = own.spectrum;
  note.textContent = `${whole.format(samples)} samples on ${patches} flat ` +
      `${patches === 1 ? 'patch' : 'patches'}; 1 = white noise`;
  plot(
      figure,
      all.filter(({spectrum}) => spectrum)
          .map(({name, spectrum}) => ({name, x: spectrum.frequency, y: spectrum.power})),
      {label: 'frequency × edge', mostX: 3, description: `Power spectrum. ${note.textContent}`});
}

/**
 * @param {{name: string, nearest: object|null, spectrum: object|null}[]} all the samples' own
 *     first
 */
export function showStatistics(all) {
  const [own] = all;
  $('distances').hidden = $('spectrum').hidden = !own?.nearest;
  if (!own?.nearest) return;
  showDistances(all.filter(({nearest}) => nearest));
  showSpectrum(all);
}

/**
 * Names the two halves of the picture.
 * @param {number|null} uniform how many samples; null: there is no half of them
 * @param {number} stratified
 */
export function showNames(uniform, stratified) {
  const names = $('names');
  names.hidden = uniform === null;
  if (names.hidden) return;
  const [left, right] = names.children;
  left.textContent = `uniform, ${whole.format(uniform)}`;
  right.textContent = `stratified, ${whole.format(stratified)}`;
}

/** Takes away what was said of the mesh before. */
export function clearResult() {
  $('figures').replaceChildren();
  $('repeat').hidden = true;
  $('download').disabled = true;
  showStatistics([]);
}

/**
 * A line for each set on screen.
 * @param {{mesh: string, stored: boolean, options: object, uniform: number, attributes: string,
 *     key: boolean}} shown uniform: how many stand beside the stratified ones; 0: they do not
 */
export function showRepeat({mesh, stored, options, uniform, attributes, key}) {
  const format = $('repeat-format').value;
  $('repeat').hidden = false;
  const sets = uniform ? [options, uniformOptions(options, uniform)] : [options];
  const lines = (line) => sets.map(line).join('\n');
  $('command').value = lines((set) => commandLine(mesh, set, format, attributes));
  const {origin} = window.location;
  $('curl').value =
      lines((set) => curlLine(mesh, set, format, attributes, {origin, key, stored}));
}

/** Hands bytes to the browser as a file. */
export function saveFile(bytes, name) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(new Blob([bytes], {type: 'application/octet-stream'}));
  link.download = name;
  link.click();
  // The browser has taken the bytes once this task is over.
  setTimeout(() => URL.revokeObjectURL(link.href));
}

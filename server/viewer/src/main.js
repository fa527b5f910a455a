// The page: a mesh comes in, the server samples it, the samples are drawn.
import {ApiError, downloadModel, hasApiKey, listModels, sample, setApiKey} from './api.js';
import {readAttributes, readOptions, reportInvalid, watchFiles, watchKeys, watchOptions, watchView} from './controls.js';
import {MOST_BYTES, readMesh} from './mesh.js';
import {outputName, queryOf, uniformOptions} from './options.js';
import {clearResult, saveFile, setState, showFigures, showNames, showProblem, showRepeat, showStatistics} from './panel.js';
import {frameOf, View} from './view.js';
import {callerOf} from './worker_call.js';

const PAUSE_MS = 150;  // Without a change, before the server is asked.

const $ = (id) => document.getElementById(id);
const decode =
    callerOf(new Worker(new URL('./draco_worker.js', import.meta.url), {type: 'module'}));
const measure =
    callerOf(new Worker(new URL('./statistics_worker.js', import.meta.url), {type: 'module'}));
const view = openView();

/**
 * What is on screen. `source`: as in api.js; null: nothing yet. `mesh` is null where the page could
 * not read what the server can.
 */
const page = {
  source: null,
  name: '',
  mesh: null,
  options: null,
  samples: null,
  uniform: null,  // As many beside them, once they were wanted.
  summary: null
};
let running = new AbortController();  // Of the request in flight: a newer one ends it.
let timer;

/** The view, or where there is no WebGL one that shows nothing: the rest of the page works. */
function openView() {
  try {
    return new View($('canvas'));
  } catch (error) {
    showProblem({title: 'This browser does not draw in three dimensions', message: error.message});
    const nothing = () => {};
    return {
      setMesh: nothing,
      setSamples: nothing,
      configure: nothing,
      home: nothing,
      orbit: nothing,
      zoom: nothing,
      draw: nothing
    };
  }
}

function fail(error) {
  if (error.name === 'AbortError') return;
  if (error instanceof ApiError && error.status === 401) $('keys-row').hidden = false;
  showProblem(error);
  setState('failed', '');
}

/** Runs `work` in place of whatever runs; what it throws is shown. */
async function run(text, work) {
  running.abort();
  const mine = running = new AbortController();
  setState('busy', text);
  try {
    await work(mine.signal);
  } catch (error) {
    if (!mine.signal.aborted) fail(error);
  }
}

// --- Sampling ------------------------------------------------------------------------------------

async function askServer(options, attributes, signal) {
  const start = performance.now();
  const query = queryOf(options, 'drc', attributes);
  const {bytes, summary, cached} = await sample(page.source, query, signal, true);
  const received = performance.now(), size = bytes.byteLength;
  const samples = await decode({bytes}, [bytes]);
  const decoded = performance.now();
  const cost = {request: received - start, decode: decoded - received, bytes: size, cached};
  return {samples, summary, cost};
}

/** The uniform samples to stand beside the stratified ones, or null. */
async function uniformBeside(signal) {
  if (!$('compare').checked || page.samples.count === 0) return null;
  if (!page.uniform) {
    const asked = page.samples;
    const options = uniformOptions(page.options, asked.count);
    const {samples} = await askServer(options, 'normal', signal);
    if (page.samples === asked) page.uniform = samples;
    return samples;
  }
  return page.uniform;
}

let measuring = Promise.resolve();

/** One at a time: a set that is overtaken while it waits is never measured. */
async function showMeasured(sets, edge, signal) {
  const before = measuring;
  let finished;
  measuring = new Promise((resolve) => finished = resolve);
  try {
    await before;
    if (signal.aborted) return;
    const measured = await Promise.all(sets.map((samples) => measure({samples, edge})));
    const names = ['stratified', 'uniform'];
    if (!signal.aborted) showStatistics(measured.map((one, i) => ({name: names[i], ...one})));
  } finally {
    finished();
  }
}

async function show(signal) {
  const {samples, summary} = page;
  const uniform = await uniformBeside(signal);
  if (signal.aborted) return;
  const sets = uniform ? [samples, uniform] : [samples];
  const {min, max} = summary.mesh.bounds;
  view.setSamples(sets, summary.lattice, page.mesh ? undefined : frameOf(min, max));
  showNames(uniform ? uniform.count : null, samples.count);
  setState('ready', `${samples.count.toLocaleString('en')} samples`);
  await showMeasured(sets, summary.lattice.edge, signal);
}

/** Shows again what is there, after a change that the server has no part in. */
function showAgain() {
  if (page.samples && document.body.dataset.state !== 'busy') run('Comparing…', show);
}

function resample() {
  clearTimeout(timer);
  if (!page.source) return;
  const options = readOptions();
  if (!options) {
    running.abort();
    fail({title: 'An option is out of range', message: reportInvalid()});
    return;
  }
  run('Sampling…', async (signal) => {
    const {samples, summary, cost} = await askServer(options, 'normal,cell,area', signal);
    if (signal.aborted) return;
    Object.assign(page, {options, samples, uniform: null, summary});
    showProblem(null);
    showFigures(summary, cost);
    repeat();
    await show(signal);
  });
}

function resampleSoon() {
  clearTimeout(timer);
  timer = setTimeout(resample, PAUSE_MS);
}

// --- Meshes --------------------------------------------------------------------------------------

function noteMesh() {
  const note = $('mesh-note');
  note.hidden = page.mesh !== null;
  note.textContent = 'This page cannot draw this file: only its samples are shown.';
  $('show-mesh').disabled = page.mesh === null;
}

/**
 * @param {import('./api.js').Source} source
 * @param {string} name of the file or model
 * @param {(signal: AbortSignal) => Promise<Blob|null>} bytes to draw the mesh from; null: too many
 */
function takeMesh(source, name, bytes) {
  clearTimeout(timer);  // What waits to be sampled is the mesh before.
  return run('Reading…', async (signal) => {
    const file = await bytes(signal);
    const mesh = file && await readMesh(file, name);
    if (signal.aborted) return;
    Object.assign(page, {source, name, mesh, options: null, samples: null, uniform: null, summary: null});
    clearResult();
    const box = mesh?.geometry.boundingBox;
    view.setMesh(mesh?.geometry ?? null, box && frameOf(box.min.toArray(), box.max.toArray()));
    view.home();
    noteMesh();
    resample();
  });
}

function takeFile(file) {
  $('model').value = '';
  return takeMesh({file}, file.name, async () => file);
}

async function offerModels() {
  const models = await listModels().catch((error) => {
    if (error.status === 401) fail(error);
    return [];
  });
  $('models').hidden = models.length === 0;
  const offered = models.map(({name, size_bytes: size}) => {
    const option = new Option(name);
    option.dataset.size = size;
    return option;
  });
  $('model').replaceChildren(new Option('choose…', ''), ...offered);
}

function takeModel() {
  const {value: name, dataset} = $('model').selectedOptions[0];
  if (!name) return;
  takeMesh(
      {model: name}, name,
      async (signal) => Number(dataset.size) > MOST_BYTES ? null : downloadModel(name, signal));
}

// --- Results -------------------------------------------------------------------------------------

function repeat() {
  if (!page.options) return;
  $('download').disabled = false;
  showRepeat({
    mesh: page.name,
    stored: page.source.model !== undefined,
    options: page.options,
    uniform: $('compare').checked ? page.samples.count : 0,
    attributes: readAttributes(),
    key: hasApiKey()
  });
}

async function download(format) {
  const {source, name, options} = page;  // As they are now: another mesh may come meanwhile.
  setState('busy', `Preparing ${format}…`);
  try {
    const {bytes, zip} = await sample(source, queryOf(options, format, readAttributes()));
    saveFile(bytes, outputName(name, zip ? 'zip' : format));
    showProblem(null);
    setState('ready', `${bytes.byteLength.toLocaleString('en')} bytes`);
  } catch (error) {
    fail(error);
  }
}

async function copy(button) {
  const text = $(button.dataset.copy);
  text.select();
  // Without TLS, beyond this machine, browsers have no clipboard for pages: the selection remains.
  const copied = await navigator.clipboard?.writeText(text.value).then(() => true, () => false);
  setState(document.body.dataset.state, copied ? 'Copied' : 'Selected: copy with Ctrl+C');
}

function start() {
  watchOptions(resampleSoon);
  watchKeys($('canvas'), view);
  watchFiles(takeFile);
  watchView((changes) => {
    view.configure(changes);
    if (!('compare' in changes)) return;
    repeat();
    showAgain();
  });
  $('model').addEventListener('change', takeModel);
  $('api-key').addEventListener('change', () => {
    setApiKey($('api-key').value);
    showProblem(null);
    offerModels();
    resample();
  });
  for (const box of document.querySelectorAll('[name=attribute]'))
    box.addEventListener('change', repeat);
  $('repeat-format').addEventListener('change', repeat);
  for (const button of document.querySelectorAll('[data-format]')) {
    button.addEventListener('click', () => download(button.dataset.format));
  }
  for (const button of document.querySelectorAll('[data-copy]')) {
    button.addEventListener('click', () => copy(button));
  }
  $('controls').addEventListener('submit', (event) => event.preventDefault());
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => view.draw());
  clearResult();
  offerModels();
}

start();

// The form: what is set in it, and telling when that changes.
import {OPTION_NAMES} from './options.js';

const $ = (id) => document.getElementById(id);

/** What a slider's position means, and back. Resolution doubles with every step of 1. */
const SCALES = {
  resolution: {value: (at) => Math.round(2 ** at), at: (value) => Math.log2(value)},
  lambda: {value: (at) => at, at: (value) => value},
  min_distance: {value: (at) => at, at: (value) => value},
};

function linkSlider(name, changed) {
  const slider = $(`${name}-slider`), box = $(name);
  const {value, at} = SCALES[name];
  const say = () => slider.setAttribute('aria-valuetext', box.value);
  slider.addEventListener('input', () => {
    box.value = String(value(Number(slider.value)));
    say();
    changed();
  });
  box.addEventListener('input', () => {
    if (box.checkValidity()) slider.value = String(at(Number(box.value)));
    say();
    changed();
  });
  say();
}

/** @returns {import('./options.js').Options|null} null while an input holds what is not allowed */
export function readOptions() {
  if (!OPTION_NAMES.every((name) => $(name).checkValidity())) return null;
  return Object.fromEntries(OPTION_NAMES.map((name) => [name, $(name).value]));
}

/** Says at the field what it takes. */
export function reportInvalid() {
  const field = OPTION_NAMES.map($).find((input) => !input.checkValidity());
  return field ? `${field.labels[0].firstChild.textContent.trim()}: ${field.validationMessage}` :
                 '';
}

/** The attributes chosen for downloads, as the option takes them. */
export function readAttributes() {
  const chosen = [...document.querySelectorAll('[name=attribute]:checked')].map((box) => box.value);
  return chosen.length ? chosen.join(',') : 'none';
}

/** Calls `changed` whenever an option of the sampling changes. */
export function watchOptions(changed) {
  Object.keys(SCALES).forEach((name) => linkSlider(name, changed));
  $('seed').addEventListener('input', changed);
  $('integrator').addEventListener('input', changed);
  $('next-seed').addEventListener('click', () => {
    const seed = $('seed');
    seed.value = seed.checkValidity() ? String(BigInt.asUintN(64, BigInt(seed.value) + 1n)) : '0';
    changed();
  });
}

const SIZES = {
  points: {min: 0.1, max: 2, step: 0.05, value: 0.6},
  strokes: {min: 0.5, max: 8, step: 0.1, value: 3}
};

/** Calls `changed` with what View.configure takes. */
export function watchView(changed) {
  const size = $('size');
  for (const radio of document.querySelectorAll('[name=mode]')) {
    radio.addEventListener('change', () => {
      const before = radio.value === 'points' ? 'strokes' : 'points';
      SIZES[before].value = size.value;
      Object.assign(size, SIZES[radio.value]);
      $('mesh-row').hidden = radio.value === 'strokes';  // Strokes need nothing but its depths.
      changed({mode: radio.value});
    });
  }
  const mode = () => document.querySelector('[name=mode]:checked').value;
  size.addEventListener('input', () => changed(mode() === 'points' ? {point: Number(size.value)} : {
                                   stroke: Number(size.value)
                                 }));
  $('colour').addEventListener('change', () => changed({colour: $('colour').value}));
  $('show-mesh').addEventListener('change', () => changed({mesh: $('show-mesh').checked}));
  $('compare').addEventListener('change', () => changed({compare: $('compare').checked}));
}

/** Keys on the canvas. */
export function watchKeys(canvas, view) {
  const turn = Math.PI / 24;
  const actions = {
    ArrowLeft: () => view.orbit(-turn, 0),
    ArrowRight: () => view.orbit(turn, 0),
    ArrowUp: () => view.orbit(0, -turn),
    ArrowDown: () => view.orbit(0, turn),
    '+': () => view.zoom(1 / 1.15),
    '=': () => view.zoom(1 / 1.15),
    '-': () => view.zoom(1.15),
    Home: () => view.home(),
  };
  canvas.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  });
}

/** Calls `take` with a file that is chosen or dropped anywhere on the page. */
export function watchFiles(take) {
  $('file').addEventListener('change', () => $('file').files[0] && take($('file').files[0]));
  const over = (event) => {
    if (!event.dataTransfer?.types.includes('Files')) return;
    event.preventDefault();
    document.body.classList.toggle('dragging', event.type === 'dragover');
    const file = event.type === 'drop' && event.dataTransfer.files[0];
    if (file) take(file);
  };
  for (const type of ['dragover', 'dragleave', 'drop']) addEventListener(type, over);
}

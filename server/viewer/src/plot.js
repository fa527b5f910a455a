// Line plots as SVG.

const WIDTH = 320, HEIGHT = 150, LEFT = 34, RIGHT = 8, TOP = 8, BOTTOM = 30;

function element(name, attributes, ...children) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** 1, 2 or 5 times a power of ten: about `wanted` steps up to `most`. */
function stepFor(most, wanted) {
  const raw = most / wanted, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= raw);
}

function ticks(most, wanted) {
  const step = stepFor(most, wanted), values = [];
  for (let i = 0; i * step <= most * 1.0001; ++i) values.push(Number((i * step).toPrecision(6)));
  return values;
}

function axes(mostX, mostY, x, y, label) {
  const parts = [];
  for (const value of ticks(mostX, 5)) {
    parts.push(
        element('text', {x: x(value), y: HEIGHT - BOTTOM + 12, 'text-anchor': 'middle'}, value));
    parts.push(element('line', {class: 'grid', x1: x(value), x2: x(value), y1: TOP, y2: y(0)}));
  }
  for (const value of ticks(mostY, 3)) {
    parts.push(element('text', {x: LEFT - 4, y: y(value) + 3, 'text-anchor': 'end'}, value));
    parts.push(
        element('line', {class: 'grid', x1: LEFT, x2: WIDTH - RIGHT, y1: y(value), y2: y(value)}));
  }
  parts.push(element(
      'text', {x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 4, 'text-anchor': 'middle'}, label));
  return parts;
}

/**
 * Replaces what is in `figure`'s .plot.
 * @param {HTMLElement} figure
 * @param {{x: number[], y: number[], name: string}[]} series the first is the samples' own
 * @param {{label: string, mostX: number, description: string}} about description: for who cannot
 *     see it
 */
export function plot(figure, series, {label, mostX, description}) {
  const mostY = 1.05 * Math.max(...series.flatMap((one) => one.y), 1e-9);
  const x = (value) => LEFT + value / mostX * (WIDTH - LEFT - RIGHT);
  const y = (value) => HEIGHT - BOTTOM - value / mostY * (HEIGHT - TOP - BOTTOM);
  const lines = series.map(
      (one, i) => element('polyline', {
        class: `series series-${i}`,
        points:
            one.x.map((value, k) => `${x(value).toFixed(1)},${y(one.y[k]).toFixed(1)}`).join(' '),
      }));
  const picture = element(
      'svg', {viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: 'img', 'aria-label': description},
      ...axes(mostX, mostY, x, y, label), ...lines);
  const legend = document.createElement('p');
  legend.className = 'legend';
  if (series.length > 1) {
    series.forEach((one, i) => {
      const name = document.createElement('span');
      name.className = `series-${i}`;
      name.textContent = one.name;
      legend.append(name);
    });
  }
  figure.querySelector('.plot').replaceChildren(picture, legend);
}

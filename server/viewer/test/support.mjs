// A service and a browser of the test's own.
import {execFileSync, spawn, spawnSync} from 'node:child_process';
import {mkdtempSync, readFileSync, rmSync, writeFileSync} from 'node:fs';
import {tmpdir} from 'node:os';
import {dirname, join} from 'node:path';
import {createInterface} from 'node:readline';
import {fileURLToPath} from 'node:url';
import {chromium} from 'playwright-core';

const STRATA = process.env.STRATA;
const PATIENCE_MS = 30000;  // For what normally takes milliseconds; only a hang reaches it.

export const SPOT =
    join(dirname(dirname(dirname(dirname(fileURLToPath(import.meta.url))))), 'models', 'spot.obj');

/** A unit cube of twelve triangles. */
export const CUBE = Buffer.from(
    [0, 1, 2, 3, 4, 5, 6, 7].map((i) => `v ${i >> 2} ${i >> 1 & 1} ${i & 1}\n`).join('') + [
      '1 2 4 3', '5 7 8 6', '1 5 6 2', '3 4 8 7', '1 3 7 5', '2 6 8 4'
    ].map((f) => `f ${f}\n`).join(''));

export function scratchFolder() {
  const path = mkdtempSync(join(tmpdir(), 'strata-viewer-'));
  return {path, remove: () => rmSync(path, {recursive: true, force: true})};
}

/** Bytes and summary of `strata sample` on a file. */
export function sampleByCommand(mesh, format, ...options) {
  const folder = scratchFolder();
  try {
    const out = join(folder.path, `out.${format}`), summary = join(folder.path, 'summary.json');
    execFileSync(STRATA, ['sample', mesh, '-o', out, '--quiet', '--summary', summary, ...options]);
    return {bytes: readFileSync(out), summary: JSON.parse(readFileSync(summary, 'utf8'))};
  } finally {
    folder.remove();
  }
}

/** A new API key, whose hash goes to the file. */
export function makeKey(file) {
  const made = spawnSync(STRATA, ['key', 'team'], {encoding: 'utf8'});
  writeFileSync(file, made.stdout);
  return /strata_\w+/.exec(made.stderr)[0];
}

/** `strata serve` on a free port: {origin, stop}. */
export async function startServer(...options) {
  const child = spawn(
      STRATA,
      ['serve', '--http', '127.0.0.1:0', '--grpc', 'off', '--log-format', 'json', ...options],
      {stdio: ['ignore', 'ignore', 'pipe']});
  const ended = new Promise((resolve) => child.once('exit', resolve));
  const lines = createInterface({input: child.stderr});
  const address = await new Promise((resolve, reject) => {
    const seen = [];
    lines.on('line', (line) => {
      seen.push(line);
      const found = /"http":"([^"]*:\d+)"/.exec(line);
      if (found) resolve(found[1]);
    });
    child.once('exit', () => reject(new Error(`the server ended: ${seen.join('\n')}`)));
  });
  const stop = () => {
    child.kill('SIGTERM');
    return ended;
  };
  return {origin: `http://${address}`, stop};
}

export async function startBrowser() {
  const options = {
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: ['--no-sandbox']
  };
  const browser = await chromium.launch(options);
  const decoder = await browser.newPage();  // Its blank page may read images, the viewer's may not.
  return {browser, decoder};
}

/** A page with the viewer that notes what went wrong: `errors`, and every address in `asked`. */
export async function openViewer(browser, origin, options = {}) {
  const context = await browser.newContext({viewport: {width: 1000, height: 700}, ...options});
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  const errors = [], asked = [];
  page.on('pageerror', (error) => errors.push(error.stack));
  page.on(
      'console',
      (line) => /Content Security|Uncaught/.test(line.text()) && errors.push(line.text()));
  page.on('request', (request) => asked.push(request.url()));
  await page.goto(`${origin}/`);
  return {page, context, errors, asked};
}

/** Waits until the page has settled in `state`. */
export async function settled(page, state = 'ready') {
  await page.waitForSelector('body[data-state=ready], body[data-state=failed]');
  const found = await page.evaluate(
      () => [document.body.dataset.state, document.getElementById('problem').textContent]);
  if (found[0] !== state) throw new Error(`expected ${state}, found ${found[0]}: ${found[1]}`);
}

/** Does `act`, then waits for samples that come after it. */
export async function resampled(page, act) {
  const answer = page.waitForResponse((response) => response.url().includes('/v1/samples'));
  await act();
  await answer;
  await settled(page);
}

/** The number that the page shows under a name. */
export async function figure(page, name) {
  const text = await page.textContent(`[data-figure="${name}"]`);
  return Number(text.replaceAll(',', ''));
}

/** The canvas as it is on screen: {width, height, data} of RGBA. */
export async function pixels(page, decoder) {
  // Two frames on: a drawing that was asked for is there.
  await page.evaluate(
      () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  const png = (await page.locator('#canvas').screenshot()).toString('base64');
  const text = await decoder.evaluate(async (base64) => {
    const picture =
        await createImageBitmap(await (await fetch(`data:image/png;base64,${base64}`)).blob());
    const canvas = new OffscreenCanvas(picture.width, picture.height),
          brush = canvas.getContext('2d');
    brush.drawImage(picture, 0, 0);
    const {data} = brush.getImageData(0, 0, picture.width, picture.height);
    let bytes = '';
    for (let i = 0; i < data.length; i += 8192) {
      bytes += String.fromCharCode(...data.subarray(i, i + 8192));
    }
    return JSON.stringify([picture.width, picture.height]) + btoa(bytes);
  }, png);
  const [head, body] = [text.slice(0, text.indexOf(']') + 1), text.slice(text.indexOf(']') + 1)];
  const [width, height] = JSON.parse(head);
  return {width, height, data: Buffer.from(body, 'base64')};
}

/** How many of a picture's pixels `is(r, g, b, x, y)`. */
export function count({width, data}, is) {
  let found = 0;
  for (let i = 0; i < data.length; i += 4) {
    const at = i / 4;
    if (is(data[i], data[i + 1], data[i + 2], at % width, Math.floor(at / width))) ++found;
  }
  return found;
}

/** Whether a pixel is neither paper nor the mesh's grey. */
export const coloured = (r, g, b) => Math.max(r, g, b) - Math.min(r, g, b) > 50;

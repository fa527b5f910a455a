// The page in a real browser, against a real service.
import assert from 'node:assert/strict';
import {readFileSync, writeFileSync} from 'node:fs';
import {join} from 'node:path';
import {after, afterEach, before, test} from 'node:test';

import {coloured, count, CUBE, figure, makeKey, openViewer, pixels, resampled, sampleByCommand, scratchFolder, settled, SPOT, startBrowser, startServer} from './support.mjs';

let server, browser, decoder, viewer;
before(async () => {
  server = await startServer();
  ({browser, decoder} = await startBrowser());
});
after(async () => {
  await browser?.close();
  assert.equal(await server?.stop(), 0);
});
afterEach(async () => {
  await viewer?.context.close();
  const errors = viewer?.errors ?? [];
  viewer = undefined;
  assert.deepEqual(errors, []);
});

async function open(options) {
  viewer = await openViewer(browser, server.origin, options);
  return viewer.page;
}

async function openWith(file, options) {
  const page = await open(options);
  await page.setInputFiles('#file', file);
  await settled(page);
  return page;
}

const cubeFile = {
  name: 'cube.obj',
  mimeType: 'model/obj',
  buffer: CUBE
};

/** Moves a slider as a hand would: to a value, with the events of it. */
const slide = (page, id, value) => page.locator(`#${id}-slider`).fill(String(value));

// --- Files ---------------------------------------------------------------------------------------

test('the page and its parts have types, tags and a policy', async () => {
  for (const [path, type] of [
           ['/', 'text/html'], ['/assets/index.js', 'text/javascript'],
           ['/assets/index.css', 'text/css'], ['/assets/draco_decoder.wasm', 'application/wasm']]) {
    const answer = await fetch(server.origin + path);
    assert.equal(answer.status, 200, path);
    assert.ok(answer.headers.get('Content-Type').startsWith(type), path);
    assert.match(
        answer.headers.get('Content-Security-Policy'), /^default-src 'none'; script-src 'self'/);
    const tag = answer.headers.get('ETag');
    const again = await fetch(server.origin + path, {headers: {'If-None-Match': tag}});
    assert.equal(again.status, 304, path);
    const other = await fetch(server.origin + path, {headers: {'If-None-Match': '"other"'}});
    assert.equal(other.status, 200, path);
  }
  for (const path of ['/assets/none.js', '/assets/../index.html', '/assets/%2e%2e/index.html']) {
    assert.equal((await fetch(server.origin + path)).status, 404, path);
  }
});

// --- Sampling ------------------------------------------------------------------------------------

test('a chosen file is sampled and its points are drawn', async () => {
  const page = await open();
  const before = count(await pixels(page, decoder), coloured);
  await page.setInputFiles('#file', SPOT);
  await settled(page);
  const drawn = count(await pixels(page, decoder), coloured);
  assert.ok(before < 2000 && drawn > 20000, `coloured pixels: ${before} before, ${drawn} after`);
  const {summary} = sampleByCommand(SPOT, 'drc', '--resolution', '64');
  assert.equal(await figure(page, 'Samples'), summary.samples.after_rejection);
  assert.equal(await figure(page, 'Occupied cells'), summary.cells);
  assert.match(await page.getAttribute('#distances svg', 'aria-label'), /smallest 0\.49/);
});

test('a dropped file is sampled', async () => {
  const page = await open();
  const files = await page.evaluateHandle((text) => {
    const transfer = new DataTransfer();
    transfer.items.add(new File([text], 'cube.obj'));
    return transfer;
  }, CUBE.toString());
  await page.dispatchEvent('#stage', 'drop', {dataTransfer: files});
  await settled(page);
  assert.ok(await figure(page, 'Samples') > 1000);
});

test('each slider samples again with its value', async () => {
  const page = await openWith(SPOT);
  await resampled(page, () => slide(page, 'resolution', 5));
  await resampled(page, () => slide(page, 'lambda', 2));
  await resampled(page, () => slide(page, 'min_distance', 0.75));
  await resampled(page, () => page.click('#next-seed'));
  await resampled(page, () => page.selectOption('#integrator', 'subdivide'));
  const {summary} = sampleByCommand(
      SPOT, 'drc', '--resolution', '32', '--lambda', '2', '--min-distance', '0.75', '--seed', '1',
      '--integrator', 'subdivide');
  assert.equal(await figure(page, 'Samples'), summary.samples.after_rejection);
  assert.match(
      await page.inputValue('#command'),
      /--resolution 32 --lambda 2 --min-distance 0.75 --seed 1 --integrator subdivide/);
});

test('a newer change ends the request in flight', async () => {
  const page = await openWith(cubeFile);
  const aborted = page.waitForEvent('requestfailed');
  let held = 0;
  await page.route(/resolution=16&/, () => {
    ++held;
  });  // Never answered.
  const asked = page.waitForRequest(/resolution=16&/);
  await slide(page, 'resolution', 4);
  await asked;
  await resampled(page, () => slide(page, 'resolution', 3));
  assert.match((await aborted).url(), /resolution=16&/);
  assert.equal(held, 1);
  const summary = await page.inputValue('#command');
  assert.match(summary, /--resolution 8 /);
});

test('an option out of range is named and not sent', async () => {
  const page = await openWith(cubeFile);
  const before = viewer.asked.length;
  await page.fill('#min_distance', '9');
  await page.waitForSelector('body[data-state=failed]');
  assert.match(await page.textContent('#problem'), /Minimum distance/);
  assert.equal(viewer.asked.length, before);
  await resampled(page, () => page.fill('#min_distance', '1'));
  assert.ok(await page.isHidden('#problem'));
});

test('a bad file is refused in the words of the API', async () => {
  const buffer = Buffer.from('ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n');
  const page = await open();
  await page.setInputFiles('#file', {name: 'bad.ply', mimeType: '', buffer});
  await settled(page, 'failed');
  const answer = await fetch(`${server.origin}/v1/samples`, {method: 'POST', body: buffer});
  const problem = await answer.json();
  assert.equal(answer.status, 422);
  assert.equal(await page.textContent('#problem strong'), problem.title);
  assert.equal(await page.textContent('#problem span'), problem.detail);
  await page.setInputFiles('#file', cubeFile);
  await settled(page);
  assert.ok(await page.isHidden('#problem'), 'a good file clears the problem');
  await page.setInputFiles('#file', {name: 'bad.ply', mimeType: '', buffer});
  await settled(page, 'failed');
  assert.equal(await page.textContent('#figures'), '', 'nothing is left of the file before');
  assert.ok(await page.isDisabled('[data-format=ply]'));
});

test('a mesh that the page cannot read is sampled all the same', async () => {
  const lines = CUBE.toString().trim().split('\n');
  const rows = lines.map((line) => line.slice(2));
  const faces = rows.slice(8).map((row) => `4 ${row.split(' ').map((i) => i - 1).join(' ')}`);
  const off = ['OFF', '8 6 0', ...rows.slice(0, 8), ...faces, ''].join('\n');
  const page = await openWith({name: 'cube.off', mimeType: '', buffer: Buffer.from(off)});
  assert.ok(await page.isVisible('#mesh-note'));
  assert.ok(count(await pixels(page, decoder), coloured) > 5000);
});

// --- What is drawn -------------------------------------------------------------------------------

// From the first view the cube shows +x, +y, +z; by their normals these are reddish, greenish and
// bluish, and the three hidden faces teal, purple and olive.
const faces = {
  shown: [
    (r, g, b) => r > g + 40 && r > b + 40, (r, g, b) => g > r + 40 && g > b + 40,
    (r, g, b) => b > r + 40 && b > g + 40
  ],
  hidden: [
    (r, g, b) => g > r + 40 && b > r + 40 && Math.abs(g - b) < 20,
    (r, g, b) => r > g + 40 && b > g + 40 && Math.abs(r - b) < 20,
    (r, g, b) => r > b + 40 && g > b + 40 && Math.abs(r - g) < 20
  ],
};

async function faceCounts(page) {
  const picture = await pixels(page, decoder);
  return Object.fromEntries(
      Object.entries(faces).map(([name, tests]) => [name, tests.map((is) => count(picture, is))]));
}

test('the mesh hides the points behind it, and only the mesh does', async () => {
  const page = await openWith(cubeFile);
  const drawn = await faceCounts(page);
  assert.ok(drawn.shown.every((n) => n > 2000), JSON.stringify(drawn));
  assert.ok(drawn.hidden.every((n) => n < 200), JSON.stringify(drawn));
  await page.uncheck('#show-mesh');
  const open = await faceCounts(page);
  assert.ok(open.hidden.some((n) => n > 2000), JSON.stringify(open));
});

test('strokes behind the surface are removed', async () => {
  const page = await openWith(cubeFile);
  const points = await pixels(page, decoder);
  await page.check('[value=strokes]');
  const drawn = await faceCounts(page);
  assert.ok(drawn.shown.every((n) => n > 5000), JSON.stringify(drawn));
  assert.ok(drawn.hidden.every((n) => n < 400), JSON.stringify(drawn));
  assert.ok(!points.data.equals((await pixels(page, decoder)).data));
});

test('colour by cell and by area change the points', async () => {
  const page = await openWith(cubeFile);
  const pictures = [await pixels(page, decoder)];
  for (const colour of ['cell', 'area']) {
    await page.selectOption('#colour', colour);
    pictures.push(await pixels(page, decoder));
  }
  for (const picture of pictures) assert.ok(count(picture, coloured) > 5000);
  assert.ok(
      !pictures[0].data.equals(pictures[1].data) && !pictures[1].data.equals(pictures[2].data));
});

test('uniform samples stand beside the stratified ones', async () => {
  const page = await openWith(cubeFile);
  await page.check('#compare');
  await page.waitForSelector('#spectrum .series-1');
  await settled(page);
  const note = await page.textContent('#distances .note');
  const variation = [...note.matchAll(/variation ([\d.]+)/g)].map((match) => Number(match[1]));
  assert.ok(variation[0] < 0.25 && variation[1] > 0.45, note);
  const picture = await pixels(page, decoder);
  const half = picture.width / 2;
  const left = count(picture, (r, g, b, x) => x < half && coloured(r, g, b));
  const right = count(picture, (r, g, b, x) => x >= half && coloured(r, g, b));
  assert.ok(left > 5000 && right > 5000 && right > left, `left ${left}, right ${right}`);
});

test('both sides have the same number of points, the uniform ones from the service', async () => {
  const page = await openWith(SPOT);
  await page.check('#compare');
  await page.waitForSelector('#distances .series-1');
  await settled(page);
  const samples = await figure(page, 'Samples');
  const said = await page.$$eval('#names span', (all) => all.map((one) => one.textContent));
  const counts = said.map((text) => Number(text.replace(/[^0-9]/g, '')));
  assert.deepEqual(counts, [samples, samples], said.join('; '));
  const asked = viewer.asked.filter((address) => address.includes('method=uniform'));
  assert.equal(asked.length, 1, asked.join('\n'));
  assert.match(asked[0], new RegExp(`count=${samples}&`));
  const commands = (await page.inputValue('#command')).split('\n');
  assert.equal(commands.length, 2);
  assert.match(commands[1], new RegExp(`-o spot-uniform.* --method uniform --count ${samples} `));
  const [, curl] = (await page.inputValue('#curl')).split('\n');
  const address = /'(http[^']*)'/.exec(curl)[1];
  const answer = await fetch(address, {method: 'POST', body: readFileSync(SPOT)});
  assert.equal(answer.status, 200);
  assert.equal(JSON.parse(answer.headers.get('Strata-Summary')).options.count, samples);
  await page.uncheck('#compare');
  assert.equal((await page.inputValue('#command')).split('\n').length, 1);
});

// --- Results -------------------------------------------------------------------------------------

test('downloads have the bytes of the API and of the command', async () => {
  const page = await openWith(SPOT);
  await page.check('[name=attribute][value=area]');
  for (const format of ['drc', 'ply', 'xyz', 'npz']) {
    const started = page.waitForEvent('download');
    await page.click(`[data-format=${format}]`);
    const saved = await started;
    assert.equal(saved.suggestedFilename(), `spot-samples.${format}`);
    const bytes = readFileSync(await saved.path());
    const query = `resolution=64&attributes=normal,area&format=${format}`;
    const answer = await fetch(
        `${server.origin}/v1/samples?${query}`, {method: 'POST', body: readFileSync(SPOT)});
    assert.ok(bytes.equals(Buffer.from(await answer.arrayBuffer())), format);
    const flags = ['--resolution', '64', '--attributes', 'normal,area'];
    assert.ok(bytes.equals(sampleByCommand(SPOT, format, ...flags).bytes), format);
  }
});

test('nothing is asked for outside the server', async () => {
  await openWith(SPOT);
  const elsewhere = viewer.asked.filter(
      (address) => !address.startsWith(`${server.origin}/`) && !address.startsWith('blob:'));
  assert.deepEqual(elsewhere, []);
});

test('a service with keys is asked with the key that is typed in', async () => {
  const folder = scratchFolder();
  const key = makeKey(join(folder.path, 'keys'));
  const guarded = await startServer('--keys', join(folder.path, 'keys'));
  try {
    viewer = await openViewer(browser, guarded.origin);
    const {page} = viewer;
    await page.setInputFiles('#file', cubeFile);
    await settled(page, 'failed');
    await resampled(page, async () => {
      await page.fill('#api-key', key);
      await page.press('#api-key', 'Enter');
    });
    const curl = await page.inputValue('#curl');
    assert.ok(curl.includes('$STRATA_KEY') && !curl.includes(key), 'the key itself is not shown');
  } finally {
    await guarded.stop();
    folder.remove();
  }
});

test('stored models are offered where the server has them', async () => {
  assert.ok(await (await open()).isHidden('#models'), 'this server stores nothing');
  await viewer.context.close();
  const folder = scratchFolder();
  const storing = await startServer('--data', join(folder.path, 'data'));
  try {
    const put = await fetch(`${storing.origin}/v1/models/a/b%20+.obj`, {method: 'PUT', body: CUBE});
    assert.ok(put.ok, await put.text());
    viewer = await openViewer(browser, storing.origin);
    const {page} = viewer;
    await page.selectOption('#model', 'a/b +.obj');
    await settled(page);
    assert.ok(await page.isHidden('#mesh-note'), 'the mesh is drawn as well');
    await resampled(page, () => slide(page, 'resolution', 4));
    assert.ok(
        viewer.asked.some((address) => address.includes('/v1/samples?model=a%2Fb%20%2B.obj&')));
    const address = /'(http[^']*)'/.exec(await page.inputValue('#curl'))[1];
    const answer = await fetch(address);
    const cube = join(folder.path, 'cube.obj');
    writeFileSync(cube, CUBE);
    const {bytes} = sampleByCommand(cube, 'drc', '--resolution', '16');
    assert.ok(
        bytes.equals(Buffer.from(await answer.arrayBuffer())), 'the request shown has the bytes');
  } finally {
    await storing.stop();
    folder.remove();
  }
});

test(
    'without WebGL the mesh is sampled all the same, and the page says what is missing',
    async () => {
      const page = await open();
      await page.addInitScript(() => HTMLCanvasElement.prototype.getContext = () => null);
      await page.reload();
      assert.match(await page.textContent('#problem'), /does not draw in three dimensions/);
      await page.setInputFiles('#file', cubeFile);
      await settled(page);
      assert.ok(await figure(page, 'Samples') > 1000);
    });

// --- Keys, widths, wishes ------------------------------------------------------------------------

test('the keyboard reaches everything and turns the model', async () => {
  const page = await openWith(cubeFile);
  await page.evaluate(() => document.activeElement.blur());
  const order = [];
  for (let i = 0; i < 12; ++i) {
    await page.keyboard.press('Tab');
    order.push(
        await page.evaluate(() => document.activeElement.id || document.activeElement.className));
  }
  assert.deepEqual(order, [
    'skip', 'canvas', 'file', 'resolution-slider', 'resolution', 'lambda-slider', 'lambda',
    'min_distance-slider', 'min_distance', 'next-seed', 'seed', 'integrator'
  ]);
  await page.focus('#canvas');
  const home = await pixels(page, decoder);
  await page.keyboard.press('ArrowLeft');
  const turned = await pixels(page, decoder);
  assert.ok(!home.data.equals(turned.data));
  await page.keyboard.press('+');
  assert.ok(!turned.data.equals((await pixels(page, decoder)).data));
  await page.keyboard.press('Home');
  assert.ok(home.data.equals((await pixels(page, decoder)).data), 'Home is where it began');
  await page.focus('#resolution-slider');
  await resampled(page, () => page.keyboard.press('ArrowRight'));
  assert.equal(await page.inputValue('#resolution'), '70');
});

test('every input has a name', async () => {
  const page = await open();
  const unnamed = await page.$$eval(
      'input, select, textarea, button, canvas',
      (all) => all.filter(
                      (one) => !one.labels?.length && !one.getAttribute('aria-label') &&
                          !one.textContent.trim())
                   .map((one) => one.outerHTML));
  assert.deepEqual(unnamed, []);
});

test('a width of 360 pixels is enough', async () => {
  const page = await openWith(cubeFile, {viewport: {width: 360, height: 740}});
  await page.check('#compare');
  await page.waitForSelector('#distances .series-1');
  assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 360);
  assert.ok(count(await pixels(page, decoder), coloured) > 3000);
});

test('the wish for dark colours and no motion is kept', async () => {
  const page = await openWith(cubeFile, {colorScheme: 'dark', reducedMotion: 'reduce'});
  const [r, g, b] = (await pixels(page, decoder)).data;
  assert.ok(r + g + b < 150, `the first pixel is ${r} ${g} ${b}`);
  const moving = await page.$$eval(
      '*',
      (all) => all.filter(
                      (one) => getComputedStyle(one).transitionDuration !== '0s' ||
                          getComputedStyle(one).animationName !== 'none')
                   .length);
  assert.equal(moving, 0);
});

test('the ranges of the inputs are the API\'s', async () => {
  const page = await open();
  const api = await (await fetch(`${server.origin}/openapi.json`)).json();
  const {parameters} = api.paths['/v1/samples'].post;
  for (const name of ['resolution', 'lambda', 'min_distance']) {
    const {schema} = parameters.find((one) => one.name === name);
    const input = page.locator(`#${name}`);
    assert.equal(Number(await input.getAttribute('min')), schema.minimum, name);
    assert.equal(Number(await input.getAttribute('max')), schema.maximum, name);
  }
});

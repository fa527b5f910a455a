// Resumable uploads by tus-js-client, which nobody here wrote.
import assert from 'node:assert/strict';
import { createServer, connect } from 'node:net';
import { Readable } from 'node:stream';
import { after, before, test } from 'node:test';

import { Upload } from 'tus-js-client';

import { Server, mesh } from './support.mjs';

const CHUNK = 16 << 10;
const SAMPLES = 'resolution=25&format=ply';
const PATIENT = Array(1200).fill(50);  // A minute for what takes an instant.
const server = new Server();
let direct;  // The samples of the mesh, sent in one request.

before(async () => {
  await server.start();
  direct = await server.bytes(`/v1/samples?${SAMPLES}`, { method: 'POST', body: mesh });
  assert(mesh.length > 4 * CHUNK, 'the mesh fills several chunks');
});
after(() => server.stop());

/** An upload of the mesh under `name`: { upload, done, offsets }, not started. `offsets` gets the
 *  Upload-Offset of each PATCH. */
function uploadOf(name, options = {}, input = mesh) {
  const offsets = [];
  let upload;
  const done = new Promise((resolve, reject) => {
    upload = new Upload(input, {
      endpoint: `${server.url}/v1/uploads`,
      metadata: { name },
      retryDelays: null,
      onBeforeRequest: (request) => {
        if (request.getMethod() === 'PATCH') offsets.push(Number(request.getHeader('Upload-Offset')));
      },
      onSuccess: resolve,
      onError: reject,
      ...options,
    });
  });
  done.catch(() => {});  // Each test awaits it where it matters.
  return { upload, done, offsets };
}

async function assertWhole(name) {
  const stored = await server.bytes(`/v1/models/${name}?content`);
  assert(stored.equals(mesh), `${name}: other bytes than were uploaded`);
  const sampled = await server.bytes(`/v1/samples?model=${name}&${SAMPLES}`);
  assert(sampled.equals(direct), `${name}: other samples than of the direct upload`);
}

test('a mesh in one piece is sampled as the direct upload', async () => {
  const { upload, done, offsets } = uploadOf('whole.obj');
  upload.start();
  await done;
  assert.deepEqual(offsets, [0]);
  await assertWhole('whole.obj');
});

test('a mesh in chunks is sampled as the direct upload', async () => {
  const { upload, done, offsets } = uploadOf('chunks.obj', { chunkSize: CHUNK });
  upload.start();
  await done;
  assert.equal(offsets.length, Math.ceil(mesh.length / CHUNK));
  assert.deepEqual(offsets, offsets.map((_, i) => i * CHUNK));
  await assertWhole('chunks.obj');
});

test('a stream of unknown length is told its length at the end', async () => {
  const { upload, done } = uploadOf('stream.obj',
    { chunkSize: CHUNK, uploadLengthDeferred: true }, Readable.from([mesh]));
  upload.start();
  await done;
  await assertWhole('stream.obj');
});

test('an upload that was paused goes on where it was, from another client', async () => {
  const first = uploadOf('paused.obj', { chunkSize: CHUNK });
  const paused = new Promise((resolve) => {
    first.upload.options.onChunkComplete = (_, accepted) => {
      if (accepted < 2 * CHUNK) return;
      first.upload.abort().then(resolve);
    };
  });
  first.upload.start();
  await paused;
  const second = uploadOf('paused.obj', { chunkSize: CHUNK, uploadUrl: first.upload.url });
  second.upload.start();
  await second.done;
  assert(second.offsets[0] >= 2 * CHUNK, `it began anew, at ${second.offsets[0]}`);
  await assertWhole('paused.obj');
});

/** A way to the service that breaks once, after `bytes` from the client have passed. */
async function breakingWay(bytes) {
  let passed = 0, broken = false;
  const way = createServer((client) => {
    const upstream = connect(server.port, '127.0.0.1');
    const end = () => { client.destroy(); upstream.destroy(); };
    for (const [from, to] of [[client, upstream], [upstream, client]]) {
      from.on('data', (piece) => to.write(piece));
      from.on('close', end);
      from.on('error', end);
    }
    client.on('data', (piece) => {
      passed += piece.length;
      if (broken || passed < bytes) return;
      broken = true;
      upstream.end();  // After what has come; the service hears an early end.
      client.resetAndDestroy();
    });
  });
  await new Promise((resolve) => { way.listen(0, '127.0.0.1', resolve); });
  return { url: `http://127.0.0.1:${way.address().port}`, wasBroken: () => broken,
           close: () => way.close() };
}

test('an upload whose connection breaks in the middle of a chunk is resumed by itself', async () => {
  const way = await breakingWay(mesh.length / 2);
  const { upload, done, offsets } = uploadOf('broken.obj', {
    endpoint: `${way.url}/v1/uploads`, retryDelays: PATIENT,
  });
  upload.start();
  await done;
  way.close();
  assert(way.wasBroken());
  assert(offsets.length >= 2 && offsets.at(-1) > 0, `it began anew: ${offsets}`);
  await assertWhole('broken.obj');
});

test('an upload goes on after the service was killed and started again', async () => {
  const { upload, done, offsets } = uploadOf('killed.obj',
    { chunkSize: CHUNK, retryDelays: PATIENT });
  let restarted;
  upload.options.onChunkComplete = (_, accepted) => {
    if (restarted || accepted < 3 * CHUNK) return;
    restarted = server.kill().then(() => server.start());
  };
  upload.start();
  await done;
  await restarted;
  const kept = offsets.filter((offset) => offset >= 3 * CHUNK);
  assert(kept.length > 0 && offsets.indexOf(0) === offsets.lastIndexOf(0), `${offsets}`);
  await assertWhole('killed.obj');
});

test('an upload that is taken back is gone', async () => {
  const { upload } = uploadOf('back.obj', { chunkSize: CHUNK });
  const back = new Promise((resolve, reject) => {
    upload.options.onChunkComplete = () => { upload.abort(true).then(resolve, reject); };
  });
  upload.start();
  await back;
  const head = await fetch(upload.url, { method: 'HEAD', headers: { 'Tus-Resumable': '1.0.0' } });
  assert.equal(head.status, 404);
  assert.equal((await fetch(`${server.url}/v1/models/back.obj`)).status, 404);
});

test('a name that leaves the folder is an error of the client, with the reason', async () => {
  const { upload, done } = uploadOf('../out.obj', { retryDelays: [0, 0] });
  upload.start();
  await assert.rejects(done, (error) => {
    assert.equal(error.originalResponse.getStatus(), 400);
    assert.equal(JSON.parse(error.originalResponse.getBody()).type, '/problems/invalid-argument');
    return true;
  });
});

// The OpenAPI document: valid to a validator that nobody here wrote, complete, and true of what the
// service answers.
import assert from 'node:assert/strict';
import { mkdtempSync, readFileSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';

import { Validator } from '@seriousme/openapi-schema-validator';
import Ajv2020 from 'ajv/dist/2020.js';
import addFormats from 'ajv-formats';

import { Server, makeKeys, mesh, source } from './support.mjs';

const ONLY_ASKED = ['voxel_size', 'height', 'threads', 'memory', 'batch_size'];
const VERBS = ['get', 'put', 'post', 'delete', 'options', 'head', 'patch'];
const folder = mkdtempSync(join(tmpdir(), 'strata-openapi-'));
const keys = makeKeys(folder);
// One model of the service's own folder is open to everybody to read; a large result fails its job.
const server = new Server(['--keys', keys.path, '--models', join(source, 'models'), '--body-size', '1M',
                           '--result-size', '1M']);
let api;

before(async () => {
  await server.start();
  api = JSON.parse(await server.bytes('/openapi.json'));
});
after(async () => {
  await server.stop();
  rmSync(folder, { recursive: true });
});

/** [verb, path, operation] of the whole document. */
function operations() {
  return Object.entries(api.paths).flatMap(([path, item]) =>
    VERBS.filter((verb) => verb in item).map((verb) => [verb, path, item[verb]]));
}

/** [verb, path, access] of the table in endpoints.cc, as the document writes them. */
function routes() {
  const text = readFileSync(join(source, 'server/http/endpoints.cc'), 'utf8');
  const rows = [...text.matchAll(/\{"([A-Z]+)", "(\/[^"]*)", Access::k(\w+)/g)];
  return rows.map(([, verb, path, access]) => [verb.toLowerCase(), path.replace('...', ''), access]);
}

// --- The document --------------------------------------------------------------------------------

test('the document is valid OpenAPI 3.1, and a broken one is not', async () => {
  const validator = new Validator();
  const good = await validator.validate(structuredClone(api));
  assert(good.valid, JSON.stringify(good.errors, null, 1));
  assert.equal(validator.version, '3.1');
  const broken = structuredClone(api);
  delete broken.paths['/v1/jobs'].post.responses['202'].description;
  assert.equal((await new Validator().validate(broken)).valid, false);
});

test('every route is in the document, and the other way round', () => {
  const table = routes().map(([verb, path]) => `${verb} ${path}`);
  assert(table.length > 20);
  assert.deepEqual(operations().map(([verb, path]) => `${verb} ${path}`).sort(), table.sort());
});

test('every reference leads somewhere and every name of an operation is its own', () => {
  const references = [...JSON.stringify(api).matchAll(/"\$ref":"#\/([^"]+)"/g)];
  assert(references.length > 20);
  for (const [, reference] of references) {
    const found = reference.split('/').reduce((part, name) => part?.[name], api);
    assert(found, `${reference} is not there`);
  }
  const names = operations().map(([, , operation]) => operation.operationId);
  assert.equal(new Set(names).size, names.length);
});

test('every parameter in a path is declared', () => {
  for (const [verb, path, operation] of operations()) {
    const declared = [...(api.paths[path].parameters ?? []), ...(operation.parameters ?? [])]
      .filter((parameter) => parameter.in === 'path').map((parameter) => parameter.name);
    const wanted = [...path.matchAll(/\{(\w+)\}/g)].map(([, name]) => name);
    assert.deepEqual(declared, wanted, `${verb} ${path}`);
  }
});

test('who needs no key is as the table has it, and as the service does', async () => {
  const open = new Map(routes().map(([verb, path, access]) => [`${verb} ${path}`, access === 'Open']));
  for (const [verb, path, operation] of operations()) {
    const told = JSON.stringify(operation.security ?? api.security).includes('{}') &&
                 !JSON.stringify(operation.security ?? api.security).includes('key');
    assert.equal(told, open.get(`${verb} ${path}`), `${verb} ${path}`);
    const answer = await fetch(server.url + path.replace(/\{\w+\}/, 'x'),
                               { method: verb.toUpperCase() });
    await answer.arrayBuffer();
    assert.equal(answer.status !== 401, told, `${verb} ${path}: ${answer.status}`);
  }
});

// --- What the service answers --------------------------------------------------------------------

/** Checks answers against the document, as strictly as it can be read: an object has no field but
 *  those it names. Remembers what it has seen. */
class Judge {
  constructor() {
    this.document = structuredClone(api);
    this.seen = new Set();
    closeObjects(this.document);
    this.ajv = new Ajv2020({ strict: false, allErrors: true });
    addFormats(this.ajv);
    this.ajv.addSchema(this.document, 'api');
  }

  /** Sends a request of an operation, checks its answer, returns { status, headers, body, json }. */
  async ask(verb, path, status, { at = path, query = '', ...init } = {}) {
    const where = `${verb} ${path} ${status}`;
    const answer = await fetch(server.url + at + query, {
      method: verb.toUpperCase(), ...init,
      headers: { Authorization: `Bearer ${keys.full}`, ...init.headers },
    });
    const body = Buffer.from(await answer.arrayBuffer());
    assert.equal(answer.status, status, `${where}: ${answer.status} ${body.subarray(0, 400)}`);
    const responses = this.document.paths[path][verb].responses;
    const row = status in responses ? String(status) : 'default';
    assert(status >= 400 || row !== 'default', `${where}: the document does not have the status`);
    this.seen.add(`${verb} ${path} ${row}`);
    this.checkHeaders(where, resolve(this.document, responses[row]), answer);
    const json = this.checkBody(where, ['paths', path, verb, 'responses', row], answer, body);
    return { status, headers: answer.headers, body, json };
  }

  checkHeaders(where, response, answer) {
    for (const [name, header] of Object.entries(response.headers ?? {})) {
      if (resolve(this.document, header).required === false) continue;
      assert(answer.headers.has(name), `${where}: the header ${name} is missing`);
    }
  }

  checkBody(where, place, answer, body) {
    const response = resolve(this.document, at(this.document, place));
    const types = Object.keys(response.content ?? {});
    if (body.length === 0) {  // Of 204, 304 and HEAD.
      assert(types.length === 0 || place[2] === 'head', `${where}: no body came`);
      return undefined;
    }
    const type = answer.headers.get('content-type').split(';')[0];
    const found = types.includes(type) ? type : types.includes('*/*') ? '*/*' : undefined;
    assert(found, `${where}: found ${type}, expected ${types}`);
    if (!type.endsWith('json') || type.endsWith('ndjson')) return undefined;
    const json = JSON.parse(body);
    this.check(where, pointerOf(this.document, place, found), json);
    return json;
  }

  check(where, pointer, json) {
    const valid = this.ajv.validate({ $ref: `api#${pointer}` }, json);
    assert(valid, `${where}: ${this.ajv.errorsText()}\n${JSON.stringify(json)}`);
    if (pointer.startsWith('/components/schemas/')) return this.note({ $ref: `#${pointer}` }, json);
    this.note(at(this.document, pointer.slice(1).split('/').map(
      (part) => decodeURIComponent(part).replaceAll('~1', '/').replaceAll('~0', '~'))), json);
  }

  /** Remembers which fields of the named schemas a value had. */
  note(schema, json) {
    if (schema.$ref) {
      const name = schema.$ref.split('/').pop();
      for (const field of Object.keys(json ?? {})) this.seen.add(`${name}.${field}`);
    }
    const whole = resolve(this.document, schema);
    if (Array.isArray(json)) {
      for (const item of json) this.note(whole.items ?? {}, item);
    } else if (json && typeof json === 'object') {
      for (const [field, value] of Object.entries(json)) {
        this.note(whole.properties?.[field] ?? {}, value);
      }
    }
  }
}

function at(document, place) { return place.reduce((part, name) => part[name], document); }

function resolve(document, part) {
  return part.$ref ? at(document, part.$ref.slice(2).split('/')) : part;
}

/** The JSON pointer of the schema of a response's content, which may stand among the components. */
function pointerOf(document, place, type) {
  const response = at(document, place);
  const base = response.$ref ? response.$ref.slice(2).split('/') : place;
  return [...base, 'content', type, 'schema']
    .map((part) => `/${encodeURIComponent(part.replaceAll('~', '~0').replaceAll('/', '~1'))}`).join('');
}

function closeObjects(part) {
  if (!part || typeof part !== 'object') return;
  if (part.type === 'object' && part.properties) part.additionalProperties = false;
  for (const value of Object.values(part)) closeObjects(value);
}

/** Every operation, each status that the document names, and a problem of each. */
async function askEverything(judge) {
  const json = { 'Content-Type': 'application/json' };
  const tus = { 'Tus-Resumable': '1.0.0' };
  const octets = { ...tus, 'Content-Type': 'application/offset+octet-stream' };
  const refused = (headers = {}) => ({ headers: { Authorization: 'Bearer x', ...headers } });

  for (const [path, place, type] of [['/', '/', 'text/html'], ['/assets/{file}', '/assets/index.js']]) {
    const { headers } = await judge.ask('get', path, 200, { at: place });
    if (type) assert(headers.get('content-type').startsWith(type));
    await judge.ask('get', path, 304, { at: place, headers: { 'If-None-Match': headers.get('etag') } });
  }
  await judge.ask('get', '/assets/{file}', 404, { at: '/assets/none' });
  for (const path of ['/livez', '/readyz', '/openapi.json', '/metrics']) {
    await judge.ask('get', path, 200);
  }
  await judge.ask('get', '/metrics', 401, refused());

  // Models.
  const model = { at: '/v1/models/a/cube.obj' };
  const put = await judge.ask('put', '/v1/models/{name}', 201, { ...model, body: mesh });
  await judge.ask('put', '/v1/models/{name}', 200, { ...model, body: mesh });
  await judge.ask('put', '/v1/models/{name}', 412,
                  { ...model, body: mesh, headers: { 'If-None-Match': '*' } });
  await judge.ask('put', '/v1/models/{name}', 413, { at: '/v1/models/large', body: Buffer.alloc(2 << 20) });
  await judge.ask('put', '/v1/models/{name}', 403,
                  { ...model, body: mesh, ...refused({ Authorization: `Bearer ${keys.read}` }) });
  await judge.ask('get', '/v1/models', 200);
  await judge.ask('get', '/v1/models', 200, { query: '?page_size=1' });
  await judge.ask('get', '/v1/models', 400, { query: '?page_size=x' });
  await judge.ask('get', '/v1/models/{name}', 200, model);
  const content = { ...model, query: '?content' };
  await judge.ask('get', '/v1/models/{name}', 200, content);
  await judge.ask('get', '/v1/models/{name}', 206, { ...content, headers: { Range: 'bytes=0-9' } });
  await judge.ask('get', '/v1/models/{name}', 304,
                  { ...content, headers: { 'If-None-Match': put.headers.get('etag') } });
  await judge.ask('get', '/v1/models/{name}', 416, { ...content, headers: { Range: 'bytes=9999999-' } });
  await judge.ask('get', '/v1/models/{name}', 404, { at: '/v1/models/none' });

  // Samples.
  for (const format of ['drc', 'ply', 'xyz', 'npz']) {
    await judge.ask('post', '/v1/samples', 200, { query: `?resolution=5&format=${format}`, body: mesh });
  }
  const { headers: zip } = await judge.ask('post', '/v1/samples', 200,
                                           { query: '?resolution=20&tile_samples=100', body: mesh });
  assert.equal(zip.get('content-type'), 'application/zip');
  for (const [status, query, body] of [[400, '?resolution=0', mesh], [422, '', 'v 0 0 0\n'.repeat(9)],
                                       [413, '', Buffer.alloc(2 << 20)]]) {
    await judge.ask('post', '/v1/samples', status, { query, body });
  }
  await judge.ask('post', '/v1/samples', 406, { body: mesh, headers: { Accept: 'image/png' } });
  await judge.ask('post', '/v1/samples', 415, { body: mesh, headers: json });
  await judge.ask('post', '/v1/samples', 401, { body: mesh, ...refused() });
  const stored = { query: '?model=spot.obj&resolution=6&format=ply' };
  const { headers } = await judge.ask('get', '/v1/samples', 200, stored);
  await judge.ask('get', '/v1/samples', 304,
                  { ...stored, headers: { 'If-None-Match': headers.get('etag') } });
  await judge.ask('get', '/v1/samples', 206, { ...stored, headers: { Range: 'bytes=0-9' } });
  await judge.ask('get', '/v1/samples', 404, { query: '?model=none' });

  // Jobs: one that succeeds, one that fails, one that is cancelled.
  const request = (options, name = 'spot.obj') =>
    ({ headers: json, body: JSON.stringify({ model: name, options }) });
  const made = await judge.ask('post', '/v1/jobs', 202, request({ resolution: 7, format: 'ply' }));
  await judge.ask('post', '/v1/jobs', 400, { headers: json, body: '{' });
  await judge.ask('post', '/v1/jobs', 404, request({}, 'none'));
  const job = { at: `/v1/jobs/${made.json.id}` };
  const done = await judge.ask('get', '/v1/jobs/{id}', 200, { ...job, query: '?wait=60' });
  assert.equal(done.json.state, 'succeeded');
  await judge.ask('get', '/v1/jobs/{id}', 404, { at: '/v1/jobs/none' });
  const events = await judge.ask('get', '/v1/jobs/{id}/events', 200, { at: `${job.at}/events` });
  const told = events.body.toString().split('\n').filter((line) => line.startsWith('data: '));
  assert(told.length > 0);
  for (const line of told) judge.check('an event', '/components/schemas/Job', JSON.parse(line.slice(6)));
  await judge.ask('get', '/v1/jobs/{id}/events', 404, { at: '/v1/jobs/none/events' });
  const result = { at: `${job.at}/result` };
  const samples = await judge.ask('get', '/v1/jobs/{id}/result', 200, result);
  await judge.ask('get', '/v1/jobs/{id}/result', 206, { ...result, headers: { Range: 'bytes=0-9' } });
  await judge.ask('get', '/v1/jobs/{id}/result', 304,
                  { ...result, headers: { 'If-None-Match': samples.headers.get('etag') } });
  await judge.ask('get', '/v1/jobs/{id}/result', 404, { at: '/v1/jobs/none/result' });
  const long = await judge.ask('post', '/v1/jobs', 202, request({ resolution: 3000, format: 'xyz' }));
  await judge.ask('get', '/v1/jobs/{id}/result', 409, { at: `/v1/jobs/${long.json.id}/result` });
  const until = Date.now() + 120_000;
  let running;
  do {
    running = await judge.ask('get', '/v1/jobs/{id}', 200,
                              { at: `/v1/jobs/${long.json.id}`, query: '?wait=1' });
  } while (!running.json.progress?.done && Date.now() < until);
  await judge.ask('delete', '/v1/jobs/{id}', 200, { at: `/v1/jobs/${long.json.id}` });
  const large = await judge.ask('post', '/v1/jobs', 202, request({ resolution: 250, format: 'xyz' }));
  const failed = await judge.ask('get', '/v1/jobs/{id}', 200,
                                 { at: `/v1/jobs/${large.json.id}`, query: '?wait=60' });
  assert.equal(failed.json.state, 'failed');  // Beyond the size of a result.
  await judge.ask('post', '/v1/jobs', 202, request({ method: 'uniform', count: '9', format: 'xyz' }));
  const again = await judge.ask('post', '/v1/jobs', 202, request({ resolution: 7, format: 'ply' }));
  await judge.ask('get', '/v1/jobs/{id}', 200, { at: `/v1/jobs/${again.json.id}`, query: '?wait=60' });
  await judge.ask('delete', '/v1/jobs/{id}', 404, { at: '/v1/jobs/none' });
  await judge.ask('get', '/v1/jobs', 200, { query: '?page_size=1' });
  await judge.ask('get', '/v1/jobs', 200);
  await judge.ask('get', '/v1/jobs', 400, { query: '?state=odd' });

  // Batches: two, so that a page is not the last.
  const order = { options: { resolution: 6, format: 'ply', normals: 'face' }, include: ['*.obj'],
                  exclude: ['none/**'], all: true };
  const asked = { headers: json, body: JSON.stringify(order) };
  const first = await judge.ask('post', '/v1/batches', 202, asked);
  await judge.ask('post', '/v1/batches', 400, { headers: json, body: '{' });
  const batch = { at: `/v1/batches/${first.json.id}` };
  const course = await judge.ask('get', '/v1/batches/{id}/events', 200, { at: `${batch.at}/events` });
  const stands = course.body.toString().split('\n').filter((line) => line.startsWith('data: '));
  assert(stands.length > 0);
  for (const line of stands) judge.check('an event', '/components/schemas/Batch', JSON.parse(line.slice(6)));
  const over = await judge.ask('get', '/v1/batches/{id}', 200, batch);
  assert.equal(over.json.state, 'succeeded');
  await judge.ask('get', '/v1/batches/{id}', 404, { at: '/v1/batches/none' });
  const lines = await judge.ask('get', '/v1/batches/{id}/manifest', 200, { at: `${batch.at}/manifest` });
  const { output } = JSON.parse(lines.body.toString().split('\n')[0]);
  await judge.ask('get', '/v1/batches/{id}/output', 200, { at: `${batch.at}/output`, query: `?path=${output}` });
  await judge.ask('get', '/v1/batches/{id}/output', 404, { at: `${batch.at}/output`, query: '?path=none' });
  const second = await judge.ask('post', '/v1/batches', 202, asked);
  await judge.ask('get', '/v1/batches', 200, { query: '?page_size=1' });
  await judge.ask('get', '/v1/batches', 400, { query: '?page_size=x' });
  await judge.ask('delete', '/v1/batches/{id}', 200, { at: `/v1/batches/${second.json.id}` });
  await judge.ask('delete', '/v1/batches/{id}', 404, { at: '/v1/batches/none' });

  // Uploads.
  const named = { ...tus, 'Upload-Metadata': `name ${Buffer.from('tus.obj').toString('base64')}` };
  await judge.ask('options', '/v1/uploads', 204);
  const begun = await judge.ask('post', '/v1/uploads', 201,
                                { headers: { ...named, 'Upload-Length': String(mesh.length) } });
  await judge.ask('post', '/v1/uploads', 412);
  const upload = { at: begun.headers.get('location') };
  await judge.ask('options', '/v1/uploads/{id}', 204, upload);
  await judge.ask('patch', '/v1/uploads/{id}', 204,
                  { ...upload, headers: { ...octets, 'Upload-Offset': '0' }, body: mesh.subarray(0, 99) });
  await judge.ask('patch', '/v1/uploads/{id}', 409,
                  { ...upload, headers: { ...octets, 'Upload-Offset': '0' }, body: mesh });
  await judge.ask('head', '/v1/uploads/{id}', 200, { ...upload, headers: tus });
  await judge.ask('delete', '/v1/uploads/{id}', 204, { ...upload, headers: tus });
  await judge.ask('head', '/v1/uploads/{id}', 404, { ...upload, headers: tus });
  await judge.ask('delete', '/v1/uploads/{id}', 404, { ...upload, headers: tus });
  await judge.ask('delete', '/v1/models/{name}', 204, model);
  await judge.ask('delete', '/v1/models/{name}', 404, model);
}

/** Two more services: one that is too busy, one that keeps nothing. */
async function askOthers(judge) {
  const text = { headers: { 'Content-Type': 'application/json' }, body: '{"model": "spot.obj"}' };
  const busy = await fetch(`${server.url}/v1/jobs`, { method: 'POST', ...text });
  judge.check('without a key', '/components/schemas/Problem', await busy.json());
  const full = await new Server(['--models', join(source, 'models'), '--stored-jobs', '1',
                                 '--jobs', '1']).start();
  let refused;
  for (let seed = 0; !refused && seed < 20; ++seed) {
    const answer = await fetch(`${full.url}/v1/jobs`, {
      ...text, method: 'POST',
      body: JSON.stringify({ model: 'spot.obj', options: { resolution: 3000, format: 'xyz', seed } }),
    });
    const body = await answer.json();
    if (answer.status === 202) continue;
    assert(answer.headers.has('retry-after'), `${answer.status} ${JSON.stringify(body)}`);
    refused = body;
  }
  await full.end('SIGKILL');
  rmSync(full.folder, { recursive: true });
  judge.check('a full queue', '/components/schemas/Problem', refused);
}

test('every answer is as the document has it, and the document has no more than is answered', async () => {
  const judge = new Judge();
  await askEverything(judge);
  await askOthers(judge);
  const missing = [];
  for (const [verb, path, operation] of operations()) {
    for (const status of Object.keys(operation.responses)) {
      const problem = status === 'default' || Number(status) >= 400;
      const what = `${verb} ${path} ${status}`;
      if (!problem && !judge.seen.has(what)) missing.push(what);
    }
  }
  for (const [name, schema] of Object.entries(api.components.schemas)) {
    if (name === 'CreateJob') continue;  // Of a request.
    for (const field of Object.keys(schema.properties)) {
      // A stored job keeps the options that decide the result.
      if (name === 'SampleOptions' && ONLY_ASKED.includes(field)) continue;
      // Of a batch that did not come to its end, failed in part or went on: service_test.py has those.
      if (name === 'Batch' && ['error', 'failed_models', 'seconds_left', 'unchanged'].includes(field)) continue;
      if (!judge.seen.has(`${name}.${field}`)) missing.push(`${name}.${field}`);
    }
  }
  assert.deepEqual(missing, [], 'in the document, but no answer had it');
});

// The server's HTTP API, docs/http.md.
import {modelQuery} from './options.js';

/** A failure the page can show. */
export class ApiError extends Error {
  /** @param {{title: string, detail?: string, status?: number}} problem as in RFC 9457 */
  constructor(problem) {
    super(problem.detail || problem.title);
    this.title = problem.title;
    this.status = problem.status ?? 0;
  }
}

/** The API key in use; empty: none. It stays in this page's memory. */
let apiKey = '';
export function setApiKey(key) {
  apiKey = key.trim();
}
export function hasApiKey() {
  return apiKey !== '';
}

async function problemOf(response) {
  const type = response.headers.get('Content-Type') ?? '';
  if (type.startsWith('application/problem+json')) return new ApiError(await response.json());
  return new ApiError(
      {title: `HTTP ${response.status}`, detail: response.statusText, status: response.status});
}

async function request(path, init = {}) {
  const headers = apiKey ? {Authorization: `Bearer ${apiKey}`} : {};
  let response;
  try {
    response = await fetch(path, {...init, headers});
  } catch (error) {
    if (error.name === 'AbortError') throw error;
    throw new ApiError({title: 'The server does not answer', detail: error.message});
  }
  if (!response.ok) throw await problemOf(response);
  return response;
}

/** @typedef {{file: Blob}|{model: string}} Source a file here, or the name of a stored model */

/**
 * Samples a mesh.
 * @param {Source} source
 * @param {string} query of queryOf
 * @param {AbortSignal} [signal] ends the request, and with it the job
 * @param {boolean} [one] whether only one file will do, and not a zip of tiles
 * @returns {Promise<{bytes: ArrayBuffer, zip: boolean, summary: object, cached: boolean}>} bytes: as
 *     the API gave them
 */
export async function sample(source, query, signal, one = false) {
  const asked = source.model === undefined ?
      request(`/v1/samples?${query}`, {method: 'POST', body: source.file, signal}) :
      request(`/v1/samples?${modelQuery(source.model)}&${query}`, {signal});
  const response = await asked;
  const summary = JSON.parse(response.headers.get('Strata-Summary') ?? '{}');
  const cached = response.headers.get('Strata-Cache') === 'hit';
  const zip = response.headers.get('Content-Type') === 'application/zip';
  if (zip && one) {
    await response.body.cancel();
    throw new ApiError({
      title: 'Too many samples to draw',
      detail: `${summary.samples.after_rejection.toLocaleString('en')} of them are a zip of tiles; ` +
          'a coarser resolution has fewer.'
    });
  }
  return {bytes: await response.arrayBuffer(), zip, summary, cached};
}

/** The stored models, as {name, size_bytes, …}; none when this server stores none. */
export async function listModels() {
  const models = [];
  let token = '';
  do {
    const query = new URLSearchParams({page_size: '1000'});
    if (token) query.set('page_token', token);
    let page;
    try {
      page = await (await request(`/v1/models?${query}`)).json();
    } catch (error) {
      if (error instanceof ApiError && [404, 501].includes(error.status)) return [];
      throw error;
    }
    models.push(...(page.models ?? []));
    token = page.next_page_token ?? '';
  } while (token);
  return models;
}

/** The bytes of a stored model. */
export async function downloadModel(name, signal) {
  const path = name.split('/').map(encodeURIComponent).join('/');
  return (await request(`/v1/models/${path}?content`, {signal})).blob();
}

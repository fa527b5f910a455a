// The server's HTTP API, docs/http.md.

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
  return new ApiError({title: `HTTP ${response.status}`, detail: response.statusText,
                       status: response.status});
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

/**
 * Samples a mesh.
 * @param {Blob} mesh
 * @param {string} query of queryOf
 * @param {AbortSignal} [signal] ends the request, and with it the job
 * @returns {Promise<{bytes: ArrayBuffer, summary: object}>} the bytes as the API gave them
 */
export async function sample(mesh, query, signal) {
  const response = await request(`/v1/samples?${query}`, {method: 'POST', body: mesh, signal});
  const summary = JSON.parse(response.headers.get('Strata-Summary') ?? '{}');
  return {bytes: await response.arrayBuffer(), summary};
}

/** The names of the stored models; none when this server stores no models. */
export async function listModels() {
  const names = [];
  let token = '';
  do {
    const query = new URLSearchParams({page_size: '1000'});
    if (token) query.set('page_token', token);
    let page;
    try {
      page = await (await request(`/v1/models?${query}`)).json();
    } catch (error) {
      if (error instanceof ApiError && error.status === 404) return [];
      throw error;
    }
    names.push(...(page.models ?? []).map((model) => model.name));
    token = page.next_page_token ?? '';
  } while (token);
  return names;
}

/** The bytes of a stored model. */
export async function downloadModel(name, signal) {
  const path = name.split('/').map(encodeURIComponent).join('/');
  return (await request(`/v1/models/${path}/content`, {signal})).blob();
}

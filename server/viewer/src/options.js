// The options of a sampling as the page holds them: texts, as they stand in its inputs. Texts,
// because a seed goes up to 2^64 - 1 and a number of JavaScript does not.

/** Names as in strata.v1.SampleOptions; the order is that of the command line shown. */
export const OPTION_NAMES = ['resolution', 'lambda', 'min_distance', 'seed', 'integrator'];

/** The names in `options`: those of the form, or those of uniformOptions. */
const namesIn = (options) =>
    ['method', 'count', ...OPTION_NAMES].filter((name) => options[name] !== undefined);

/**
 * @typedef {{resolution: string, lambda: string, min_distance: string, seed: string,
 *             integrator: string}} Options as the form has them; uniformOptions has others
 */

/**
 * The query of POST /v1/samples.
 * @param {Options} options
 * @param {string} format
 * @param {string} attributes names with commas between, or "none"
 */
export function queryOf(options, format, attributes) {
  const query = new URLSearchParams();
  for (const name of namesIn(options)) query.set(name, options[name]);
  query.set('format', format);
  query.set('attributes', attributes);
  return query.toString().replaceAll('%2C', ',').replaceAll('+', '%20');
}

/**
 * The options of uniform samples beside those of `options`: as many, with the same lattice and seed.
 * @param {Options} options
 * @param {number} count
 */
export function uniformOptions({resolution, seed}, count) {
  return {method: 'uniform', count: String(count), resolution, seed};
}

/** The part of a query that names a stored model. */
export function modelQuery(name) {
  return `model=${encodeURIComponent(name)}`;
}

/** `text` as one word for a POSIX shell. */
export function shellWord(text) {
  return /^[\w./:=,@%+-]+$/.test(text) ? text : `'${text.replaceAll('\'', '\'\\\'\'')}'`;
}

/** A file name as an argument: one that begins with "-" would be taken for an option. */
function shellFile(name) {
  return shellWord(name.startsWith('-') ? `./${name}` : name);
}

/** The mesh's name with what the samples are and the suffix of their format. */
export function outputName(mesh, format, what = 'samples') {
  const stem = mesh.replace(/^.*[/\\]/, '').replace(/\.(gz|zst)$/i, '').replace(/\.[^.]*$/, '');
  return `${stem || 'mesh'}-${what}.${format}`;
}

const outputOf = (mesh, options, format) =>
    shellFile(outputName(mesh, format, options.method === 'uniform' ? 'uniform' : 'samples'));

/** The command that writes the same bytes. */
export function commandLine(mesh, options, format, attributes) {
  const flags =
      namesIn(options).map((name) => `--${name.replaceAll('_', '-')} ${shellWord(options[name])}`);
  return [
    'strata sample', shellFile(mesh), '-o', outputOf(mesh, options, format), ...flags,
    `--attributes ${attributes}`
  ].join(' ');
}

/**
 * The request that answers with the same bytes.
 * @param {string} mesh the name of a file, or of a stored model
 * @param {{origin: string, key: boolean, stored: boolean}} server key: whether one must be shown
 */
export function curlLine(mesh, options, format, attributes, {origin, key, stored}) {
  const words = ['curl --fail-with-body'];
  if (key) words.push('-H "Authorization: Bearer $STRATA_KEY"');
  if (!stored) words.push('-X POST -T', shellFile(mesh));
  const model = stored ? `${modelQuery(mesh)}&` : '';
  const address = `${origin}/v1/samples?${model}${queryOf(options, format, attributes)}`;
  words.push('-o', outputOf(mesh, options, format), shellWord(address));
  return words.join(' ');
}

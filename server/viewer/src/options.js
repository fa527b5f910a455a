// The options of a sampling as the page holds them: texts, as they stand in its inputs. Texts,
// because a seed goes up to 2^64 - 1 and a number of JavaScript does not.

/** Names as in strata.v1.SampleOptions; the order is that of the command line shown. */
export const OPTION_NAMES = ['resolution', 'lambda', 'min_distance', 'seed', 'integrator'];

/**
 * @typedef {{resolution: string, lambda: string, min_distance: string, seed: string,
 *             integrator: string}} Options
 */

/**
 * The query of POST /v1/samples.
 * @param {Options} options
 * @param {string} format
 * @param {string} attributes names with commas between, or "none"
 */
export function queryOf(options, format, attributes) {
  const query = new URLSearchParams();
  for (const name of OPTION_NAMES) query.set(name, options[name]);
  query.set('format', format);
  query.set('attributes', attributes);
  return query.toString().replaceAll('%2C', ',').replaceAll('+', '%20');
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

/** The mesh's name with the suffix of the samples' format. */
export function outputName(mesh, format) {
  const stem = mesh.replace(/^.*[/\\]/, '').replace(/\.(gz|zst)$/i, '').replace(/\.[^.]*$/, '');
  return `${stem || 'mesh'}-samples.${format}`;
}

/** The command that writes the same bytes. */
export function commandLine(mesh, options, format, attributes) {
  const flags =
      OPTION_NAMES.map((name) => `--${name.replaceAll('_', '-')} ${shellWord(options[name])}`);
  return [
    'strata sample', shellFile(mesh), '-o', shellFile(outputName(mesh, format)), ...flags,
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
  words.push('-o', shellFile(outputName(mesh, format)), shellWord(address));
  return words.join(' ');
}

// dist/ is what src/ builds to: built again elsewhere, compared byte by byte.
import assert from 'node:assert/strict';
import {mkdtempSync, readdirSync, readFileSync, rmSync} from 'node:fs';
import {tmpdir} from 'node:os';
import {dirname, join} from 'node:path';
import {test} from 'node:test';
import {fileURLToPath} from 'node:url';
import {build} from 'vite';

const viewer = dirname(dirname(fileURLToPath(import.meta.url)));

function contents(folder) {
  const files =
      readdirSync(folder, {recursive: true, withFileTypes: true}).filter((e) => e.isFile());
  return new Map(files.map((entry) => join(entry.parentPath, entry.name))
                     .map((path) => [path.slice(folder.length), readFileSync(path)])
                     .sort(([a], [b]) => a < b ? -1 : 1));
}

test('dist is what the source builds to', async () => {
  const folder = mkdtempSync(join(tmpdir(), 'strata-viewer-'));
  try {
    await build({
      root: viewer,
      configFile: join(viewer, 'vite.config.js'),
      logLevel: 'error',
      build: {outDir: folder, emptyOutDir: true}
    });
    const built = contents(folder), kept = contents(join(viewer, 'dist'));
    assert.deepEqual([...kept.keys()], [...built.keys()]);
    for (const [path, bytes] of built) {
      assert.ok(bytes.equals(kept.get(path)), `dist${path} is out of date: npm run build`);
    }
  } finally {
    rmSync(folder, {recursive: true});
  }
});

// Asks the Khronos validator about a GLB: node validate.mjs FILE. Prints its report as JSON.
// Exit status 77 where the validator is not installed (npm ci in this folder).
import {readFileSync} from 'node:fs';

let validator;
try {
  validator = await import('gltf-validator');
} catch {
  process.exit(77);
}
const report = await validator.default.validateBytes(new Uint8Array(readFileSync(process.argv[2])));
console.log(JSON.stringify(report));

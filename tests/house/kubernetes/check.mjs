// Every document of the manifests named on the command line must be what Kubernetes' schemas ask for: values by the
// compiled schemas of kubernetes-models, names of fields (which those schemas leave open) by TypeScript
// against its types. With --self-test, planted mistakes must be found.
import { readFileSync, rmSync, writeFileSync } from "node:fs";
import { basename, join } from "node:path";
import { parseAllDocuments } from "yaml";
import ts from "typescript";

const here = import.meta.dirname;

function documents(path, text) {
  return parseAllDocuments(text).map((document, index) => {
    if (document.errors.length) throw new Error(`${path}: ${document.errors[0].message}`);
    return { name: `${basename(path)}, document ${index + 1}`, value: document.toJS() };
  });
}

/** Where kubernetes-models keeps the kind: "apps/v1/Deployment". */
function moduleOf(value) {
  return `kubernetes-models/${value.apiVersion}/${value.kind}`;
}

async function faultsOfValues({ name, value }) {
  try {
    const module = await import(moduleOf(value));
    new module[value.kind](value).validate();
    return [];
  } catch (error) {
    return [`${name} (${value.kind}): ${error.message}`];
  }
}

function faultsOfNames(all) {
  const files = all.map(({ value }, index) => {
    const path = join(here, `checked-${process.pid}-${index}.ts`);
    writeFileSync(path, `import type { I${value.kind} } from "${moduleOf(value)}";\n` +
      `export const checked: I${value.kind} = ${JSON.stringify(value, null, 2)};\n`);
    return path;
  });
  try {
    const program = ts.createProgram(files, {
      noEmit: true, strict: true, skipLibCheck: true, types: [],
      module: ts.ModuleKind.NodeNext, moduleResolution: ts.ModuleResolutionKind.NodeNext,
    });
    return ts.getPreEmitDiagnostics(program).map((found) => {
      const message = ts.flattenDiagnosticMessageText(found.messageText, " ");
      return `${all[files.indexOf(found.file?.fileName)]?.name}: ${message}`;
    });
  } finally {
    files.forEach((path) => rmSync(path));
  }
}

async function faults(all) {
  const values = (await Promise.all(all.map(faultsOfValues))).flat();
  return values.concat(values.length ? [] : faultsOfNames(all));
}

const [mode, ...paths] = process.argv.slice(2);
if (mode === "--self-test") {
  const text = readFileSync(paths[0], "utf8");
  const planted = [["replicas: 2", "replicas: two"], ["readinessProbe:", "readynessProbe:"],
    ["minAvailable: 1", "minAvailable: [1]"], ["restartPolicy: Never", "restartPolicy: 1"],
    ["kind: Service\n", "kind: Servant\n"], ["accessModes: [ReadWriteMany]", "accessModes: ReadWriteMany"]]
    .filter(([from]) => text.includes(from));
  for (const [from, to] of planted) {
    const found = await faults(documents("planted.yaml", text.replace(from, to)));
    if (!found.length) throw new Error(`not found: '${to}' for '${from}'`);
  }
  console.log(`The check finds all ${planted.length} planted mistakes.`);
} else {
  const all = [mode, ...paths].flatMap((path) => documents(path, readFileSync(path, "utf8")));
  const found = await faults(all);
  found.forEach((line) => console.log(line));
  if (!found.length) console.log(`${all.length} documents are what the schemas ask for.`);
  process.exitCode = found.length ? 1 : 0;
}

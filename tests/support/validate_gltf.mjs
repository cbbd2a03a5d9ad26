// Runs the Khronos glTF validator over files named on standard input, one per line, and prints one JSON line for each:
// {"file": …, "errors": {"CODE": count}, "warnings": {"CODE": count}}.
// Usage: node validate_gltf.mjs FOLDER_WITH_NODE_MODULES < names
import { createRequire } from 'node:module';
import { readFileSync } from 'node:fs';
import path from 'node:path';

const require = createRequire(path.join(path.resolve(process.argv[2]), 'package.json'));
const validator = require('gltf-validator');

for (const file of readFileSync(0, 'utf8').split('\n').filter(Boolean)) {
  const folder = path.dirname(file);
  const counts = { file, errors: {}, warnings: {} };
  try {
    const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), {
      uri: path.basename(file),
      maxIssues: 0,
      externalResourceFunction: async (uri) => new Uint8Array(readFileSync(path.join(folder, decodeURIComponent(uri)))),
    });
    for (const { code, severity } of report.issues.messages) {
      const kind = ['errors', 'warnings'][severity];
      if (kind) counts[kind][code] = (counts[kind][code] ?? 0) + 1;
    }
  } catch (error) {
    counts.errors[`CANNOT_VALIDATE ${error}`] = 1;
  }
  console.log(JSON.stringify(counts));
}

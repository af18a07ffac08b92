// Builds the viewer to one file that a page can carry: `npm ci && npm run build` in this folder.
// The first line names three.js with its version and licence, and holds a hash of what the file was built from.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { copyFileSync, readFileSync, readdirSync, writeFileSync } from "node:fs";

const target = new URL("../miniloop_cli/report/viewer/assets/", import.meta.url);
const sources = new URL("src/", import.meta.url);

// Names and contents in order of name; tests/viewer computes the same.
const hash = createHash("sha256");
for (const name of readdirSync(sources).sort()) hash.update(name + "\n").update(readFileSync(new URL(name, sources)));
hash.update(readFileSync(new URL("package-lock.json", import.meta.url)));

const { version } = JSON.parse(readFileSync(new URL("node_modules/three/package.json", import.meta.url)));
const result = await build({
  entryPoints: [new URL("main.js", sources).pathname],
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  legalComments: "none", // the licence is a file beside the built one
  charset: "ascii",
  write: false,
});
const code = result.outputFiles[0].text.trimEnd();
if (/<\/script|<!--/i.test(code)) throw new Error("the built file would end the script element that carries it");
const note = `/* three.js ${version}, MIT licence: three.LICENSE.txt; built from viewer/src, ${hash.digest("hex")} */`;
writeFileSync(new URL("viewer.js", target), `${note}\n${code}\n`);
copyFileSync(new URL("node_modules/three/LICENSE", import.meta.url), new URL("three.LICENSE.txt", target));
console.log(`viewer.js: ${Math.round(code.length / 1000)} kB, three.js ${version}`);

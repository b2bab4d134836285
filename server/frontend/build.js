// Bundles src/ into the static folder of the web package. Run by `npm run build`, also in the image.

import { readFile, writeFile } from "node:fs/promises";
import { build, context } from "esbuild";

const OUT = "../robotether_server/web/static/dist";

// roslib brings decoders (BSON, CBOR, PNG) and a Node.js socket for its own transports. The pages use
// their own JSON transport (src/client/rosbridge.js), so these would only be dead weight in the bundle.
const UNUSED = /^(bson|cbor2|fast-png|ws)$|^\.\/(Native|Ws)WebSocketTransport-/;

// roslib reads robots' models with an XML parser that it has in its own bundle (/^var x = y();$/m), and that no page uses;
// esbuild leaves out what is not used once it knows that the call does nothing else.
const XML_PARSER = /^(var \w+ = )(\w+\(\);)$/gm;

const leaveOutUnused = {
  name: "leave-out-unused",
  setup(builder) {
    builder.onResolve({ filter: UNUSED }, ({ path }) => ({ path, namespace: "unused" }));
    builder.onLoad({ filter: /.*/, namespace: "unused" }, () => ({
      contents: "module.exports = {}",
      loader: "js",
    }));
    builder.onLoad({ filter: /\/RosLib\.js$/ }, async ({ path }) => {
      const text = await readFile(path, "utf8");
      const found = text.match(XML_PARSER) ?? [];
      if (found.length !== 1) throw new Error(`cannot leave out roslib's XML parser: ${found.length} places look like its call, not 1`);
      return { contents: text.replace(XML_PARSER, "$1/* @__PURE__ */ $2"), loader: "js" };
    });
  },
};

const options = {
  entryPoints: {
    copy: "src/pages/copy.js",
    drive: "src/pages/drive.js",
    fleet: "src/pages/fleet.js",
    "robotether-client": "src/client/index.js",
  },
  outdir: OUT,
  bundle: true,
  minify: true,
  format: "esm",
  target: ["safari15", "chrome100", "firefox100"],
  legalComments: "none",
  metafile: true,
  plugins: [leaveOutUnused],
  logLevel: "info",
};

// The licences of what is in the bundle ask for their text beside it.
async function writeLicences(inputs) {
  const packages = new Set();
  for (const path of Object.keys(inputs)) {
    const match = /^node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(path);
    if (match) packages.add(match[1]);
  }
  const texts = [...packages].sort().map(async (name) => `${name}\n\n${await licence(name)}`);
  await writeFile(`${OUT}/LICENSES.txt`, (await Promise.all(texts)).join("\n\n----\n\n"));
}

async function licence(name) {
  for (const file of ["LICENSE", "LICENSE.md"]) {
    const text = await readFile(`node_modules/${name}/${file}`, "utf8").catch(() => null);
    if (text) return text;
  }
  throw new Error(`cannot write LICENSES.txt: package ${name} has no LICENSE file; leave it out or add its text`);
}

if (process.argv.includes("--watch")) {
  await (await context(options)).watch();
} else {
  const { metafile } = await build(options);
  await writeLicences(metafile.inputs);
}

// Bundles src/ into the static folder of the web package, with the licences of the packages in it. Run by `npm run build`, also in the
// image.

import { readdir, readFile, writeFile } from "node:fs/promises";

import { build, context } from "esbuild";

const options = {
  entryPoints: {
    addRobot: "src/pages/addRobot.js",
    desk: "src/pages/desk.js",
    drive: "src/pages/drive.js",
    fleet: "src/pages/fleet.js",
    grants: "src/pages/grants.js",
    health: "src/pages/health.js",
    queue: "src/pages/queue.js",
    replay: "src/pages/replay.js",
    routes: "src/pages/routes.js",
    "robotether-client": "src/client/index.js",
    supervise: "src/pages/supervise.js",
    ticker: "src/pages/ticker.js",
    wall: "src/pages/wall.js",
  },
  outdir: "../robotether_server/web/static/dist",
  bundle: true,
  minify: true,
  format: "esm",
  target: ["safari15", "chrome100", "firefox100"],
  metafile: true,
  logLevel: "info",
};

// Of each package of which something is in a bundle.
async function licences({ inputs }) {
  const folders = new Set(Object.keys(inputs).flatMap((path) => path.match(/^node_modules\/(?:@[^/]+\/)?[^/]+/) ?? []));
  const texts = [...folders].sort().map(async (folder) => {
    const file = (await readdir(folder)).find((name) => /^licen[cs]e/i.test(name));
    if (!file) throw new Error(`cannot build: ${folder} has no licence`);
    return `${folder.replace("node_modules/", "")}\n\n${await readFile(`${folder}/${file}`, "utf8")}`;
  });
  return (await Promise.all(texts)).join("\n\n");
}

if (process.argv.includes("--watch")) {
  await (await context(options)).watch();
} else {
  const { metafile } = await build(options);
  await writeFile(`${options.outdir}/licences.txt`, await licences(metafile));
}

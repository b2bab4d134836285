// Bundles src/ into the static folder of the web package. Run by `npm run build`, also in the image.

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
  logLevel: "info",
};

if (process.argv.includes("--watch")) {
  await (await context(options)).watch();
} else {
  await build(options);
}

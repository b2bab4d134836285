// Bundles src/ into the static folder of the web package. Run by `npm run build`, also in the image.
import { build, context } from "esbuild";

const OUT = "../robotether_server/web/static/dist";

// roslib brings decoders (BSON, CBOR, PNG) and a Node.js socket for its own transports. The pages use
// their own JSON transport (src/transport.js), so these would only be dead weight in the bundle.
const UNUSED = /^(bson|cbor2|fast-png|ws)$|^\.\/(Native|Ws)WebSocketTransport-/;

const leaveOutUnused = {
  name: "leave-out-unused",
  setup(builder) {
    builder.onResolve({ filter: UNUSED }, ({ path }) => ({ path, namespace: "unused" }));
    builder.onLoad({ filter: /.*/, namespace: "unused" }, () => ({
      contents: "module.exports = {}",
      loader: "js",
    }));
  },
};

const options = {
  entryPoints: ["src/drive.js", "src/fleet.js"],
  outdir: OUT,
  bundle: true,
  minify: true,
  format: "esm",
  target: ["safari15", "chrome100", "firefox100"],
  legalComments: "none",
  plugins: [leaveOutUnused],
  logLevel: "info",
};

if (process.argv.includes("--watch")) {
  await (await context(options)).watch();
} else {
  await build(options);
}

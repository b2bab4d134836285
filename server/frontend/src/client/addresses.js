// Where a robot's WebSockets and streams are (docs/reference/protocols.md, docs/reference/media.md). Pure.

// A query with its slashes as they are: web_video_server takes what stands there for the topic and undoes no escapes.
export const plainQuery = (words) => new URLSearchParams(words).toString().replaceAll("%2F", "/");

// `server` is https://HOST[:PORT]; `ticket` may be missing where a login does.
export const rosUrl = (server, robot, ticket) => address(server, robot, "ros", { ticket }, true);

export const framesUrl = (server, robot, topic, ticket) => address(server, robot, "video/frames", { topic, ticket }, true);

export const streamUrl = (server, robot, topic, ticket, more = {}) => address(server, robot, "video/stream", { topic, ...more, ticket });

function address(server, robot, path, query, socket = false) {
  const url = new URL(`/robots/${encodeURIComponent(robot)}/${path}`, server);
  url.search = plainQuery(Object.entries(query).filter(([, value]) => value !== undefined));
  if (socket) url.protocol = url.protocol.replace("http", "ws");
  return url.href;
}

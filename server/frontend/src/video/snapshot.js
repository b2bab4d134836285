// A still at full quality, saved as a file.

import { plainQuery } from "../client/addresses.js";

const FULL_QUALITY = 100;

export function snapshotUrl(robot, topic) {
  const query = plainQuery({ topic, quality: FULL_QUALITY });
  return `/robots/${encodeURIComponent(robot)}/video/snapshot?${query}`;
}

// robot-camera-20260101T120304Z.jpg; a camera's name may have what no file name may.
export function snapshotName(robot, camera, time) {
  const plain = camera.replace(/[^A-Za-z0-9]+/g, "-").replace(/^-|-$/g, "") || "camera";
  return `${robot}-${plain}-${time.toISOString().replace(/[-:]|\.\d+/g, "")}.jpg`;
}

// Gives null, or the status of the answer that was no picture (0 for none).
export async function saveSnapshot(robot, { topic, name }) {
  const answer = await fetch(snapshotUrl(robot, topic), { cache: "no-store" }).catch(() => null);
  const isImage = answer?.ok && answer.headers.get("Content-Type")?.startsWith("image/");
  const image = isImage && (await answer.blob().catch(() => null));
  if (!image) return answer?.status ?? 0;
  download(image, snapshotName(robot, name, new Date()));
  return null;
}

function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  // The browser has taken the blob up by the next task.
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

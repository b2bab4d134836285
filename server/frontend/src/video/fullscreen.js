// The whole drive page in fullscreen: the picture alone would leave stick and Stop behind.

export const mayBeFull = (root) =>
  Boolean(root.requestFullscreen ?? root.webkitRequestFullscreen);

const isFull = () =>
  Boolean(document.fullscreenElement ?? document.webkitFullscreenElement);

// Tells the style sheets, which have no one name for it in all browsers.
export function markFull(root) {
  for (const name of ["fullscreenchange", "webkitfullscreenchange"]) {
    document.addEventListener(name, () => (root.dataset.full = isFull()));
  }
}

// Refused when no key or click is behind it; then the page stays as it is.
export async function toggleFull(root) {
  const act = isFull()
    ? (document.exitFullscreen ?? document.webkitExitFullscreen).bind(document)
    : (root.requestFullscreen ?? root.webkitRequestFullscreen)?.bind(root);
  try {
    await act?.();
  } catch {
    return;
  }
}

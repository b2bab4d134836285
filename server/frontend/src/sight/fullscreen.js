// The whole drive page in fullscreen: the picture alone would leave stick and Stop behind.

export const mayBeFull = (root) =>
  Boolean(root.requestFullscreen ?? root.webkitRequestFullscreen);

export const isFull = () =>
  Boolean(document.fullscreenElement ?? document.webkitFullscreenElement);

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

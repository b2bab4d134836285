// Buttons that copy a text of the page: data-copy is the id of its element. They show only where copying works.

const SHOWN_MS = 2000;

export function wireCopyButtons(page, clipboard) {
  if (!clipboard) return;
  for (const button of page.querySelectorAll("[data-copy]")) {
    const words = button.textContent;
    button.hidden = false;
    button.addEventListener("click", async () => {
      button.textContent = await copied(clipboard, page.getElementById(button.dataset.copy).textContent);
      setTimeout(() => {
        button.textContent = words;
      }, SHOWN_MS);
    });
  }
}

async function copied(clipboard, text) {
  try {
    await clipboard.writeText(text);
    return "Copied";
  } catch {
    return "Select and copy by hand";
  }
}

if (typeof document !== "undefined") wireCopyButtons(document, navigator.clipboard);

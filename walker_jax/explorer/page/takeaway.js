// What one takes away: the command, the Python, the picture and the data.

import { ask, fetchBytes } from "./api.js";
import { png, svg } from "./saved.js";

export class TakeAway {
  /** `wanted` gives the body of a request for what is shown, `drawing` what is saved of it (`saved.js`). */
  constructor(root, { wanted, drawing, say, title }) {
    const on = (id, act) => root.querySelector(id).addEventListener("click", async (event) => {
      const button = event.currentTarget;
      button.disabled = true;
      try {
        await act();
      } catch (error) {
        say(error.message);
      } finally {
        button.disabled = false;
      }
    });
    const copyWords = (kind, name) => async () => {
      const words = await ask("/api/words", wanted());
      await copy(words[kind]);
      say(`${name} copied`);
    };
    on("#copy-command", copyWords("command", "Command"));
    on("#copy-python", copyWords("python", "Python"));
    on("#save-png", async () => save(await png(drawing()), `${title()}.png`));
    on("#save-svg", async () => save(svg(drawing()), `${title()}.svg`));
    on("#save-data", async () => {
      say("The data are being computed");
      save(new Blob([await fetchBytes("/api/data", wanted())]), `${title()}.zarr.zip`);
      say("Data saved: xarray.open_zarr reads the zip archive");
    });
  }
}

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch { // in a frame that may not: by the old way
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    if (!done) throw new Error(`The browser does not let this page copy: ${text}`);
  }
}

function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

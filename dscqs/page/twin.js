/**
 * The page twice, for displays that take two pictures in one signal.
 *
 * On side by side and top-bottom displays each eye sees its own half of the signal. The page
 * itself lies in the first half; a copy that only mirrors it fills the other.
 */

import { MODES } from "./layout.js";

/** Begin to mirror `original` for a profile; does nothing where one page is enough. */
export function mirror(original, profile) {
  const { parts, squeeze } = MODES[profile.mode];
  if (parts[0] * parts[1] === 1) return;
  const root = document.documentElement;
  root.dataset.halves = parts[0] === 2 ? "beside" : "above";
  root.dataset.squeezed = squeeze[0] * squeeze[1] === 2 ? "yes" : "no";
  const copy = document.createElement("div");
  copy.className = "copy";
  copy.inert = true;
  copy.setAttribute("aria-hidden", "true");
  original.after(copy);
  let isAsked = false;
  const renew = () => {
    isAsked = false;
    copy.replaceChildren(copyOf(original));
    copy.firstChild.scrollTop = original.scrollTop;
  };
  const ask = () => {
    if (isAsked) return;
    isAsked = true;
    requestAnimationFrame(renew);
  };
  new MutationObserver(ask).observe(original, {
    subtree: true,
    childList: true,
    attributes: true,
    characterData: true,
  });
  for (const name of ["input", "change", "focusin"]) original.addEventListener(name, ask);
  original.addEventListener("scroll", ask, true);
  ask();
}

/** Return a copy that looks the same: marks, entries and drawings too, but no names. */
function copyOf(original) {
  const copy = original.cloneNode(true);
  const from = [original, ...original.querySelectorAll("*")];
  const to = [copy, ...copy.querySelectorAll("*")];
  from.forEach((element, index) => {
    const made = to[index];
    made.removeAttribute("id");
    made.removeAttribute("name");
    if (element instanceof HTMLInputElement) {
      made.checked = element.checked;
      made.value = element.value;
    } else if (element instanceof HTMLCanvasElement && element.width && element.height) {
      made.getContext("2d").drawImage(element, 0, 0);
    }
    if (element.matches(":focus-visible")) made.classList.add("focused");
  });
  return copy;
}

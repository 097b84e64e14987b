/** Makes elements. */

/**
 * Return an element. Attributes: `class`, `text`, `on…` (listeners), booleans, or any other name.
 */
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "text") made.textContent = value;
    else if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return made;
}

/** Return a button. */
export function button(text, onclick, attributes = {}) {
  return el("button", { type: "button", text, onclick, ...attributes });
}

/** Return a group of radio buttons; `options` are [value, label]; `onchange` gets the value. */
export function choices({ name, legend, options, onchange, value = null }) {
  return el(
    "fieldset",
    { class: "choices" },
    el("legend", { text: legend }),
    el(
      "div",
      { class: "options" },
      options.map(([option, label]) =>
        el(
          "label",
          {},
          el("input", {
            type: "radio",
            name,
            value: option,
            checked: option === value,
            onchange: () => onchange(option),
          }),
          el("span", { text: label }),
        ),
      ),
    ),
  );
}

/** Put a page in place of the one before, and lead the keyboard and screen readers to its head. */
export function show(main, name, ...children) {
  main.dataset.page = name;
  main.replaceChildren(...children.flat().filter(Boolean));
  const head = main.querySelector("h1");
  if (head) {
    head.tabIndex = -1;
    head.focus({ preventScroll: true });
  }
  scrollTo(0, 0);
}

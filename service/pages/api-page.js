/** The description of the interface, for people. */

import { ask, element, trying } from "./api.js";

const nameOf = (schema) => schema?.$ref?.split("/").at(-1);

/** The examples of a body or an answer with their names; none where it is of bytes. */
function examplesOf({ example, examples, schema }, refs) {
  if (example !== undefined) return [["", example]];
  if (examples) return Object.entries(examples).map(([name, { value }]) => [`: ${name}`, value]);
  if (schema?.type === "array") {
    return examplesOf({ schema: schema.items }, refs).map(([name, value]) => [name, [value]]);
  }
  const known = refs[nameOf(schema)] ?? schema;
  return (known?.examples ?? []).slice(0, 1).map((value) => ["", value]);
}

function shown(title, value) {
  const text = typeof value === "string" ? value : JSON.stringify(value, null, 1);
  return element("details", {}, element("summary", {}, title), element("pre", { tabindex: 0 }, text));
}

function operationItem(path, method, operation, refs) {
  const parameters = [...(operation.parameters ?? [])].map((item) => element("tr", {},
    element("td", {}, element("code", {}, item.name)), element("td", {}, item.in),
    element("td", {}, item.description ?? item.schema?.title ?? "")));
  const answers = Object.entries(operation.responses).map(([status, item]) => element("tr", {},
    element("td", {}, status), element("td", { colspan: 2 }, item.description)));
  const body = operation.requestBody?.content ?? {};
  const [what, ...more] = (operation.description ?? "").replaceAll("``", "").split("\n\n");
  const details = element("details", { class: "panel" },
    element("summary", {}, element("strong", {}, method.toUpperCase()), " ", element("code", {}, path),
      " ", element("span", { class: "soft" }, what)),
    ...more.map((text) => element("p", {}, text)));
  for (const [type, item] of Object.entries(body)) {
    const name = nameOf(item.schema);
    details.append(element("p", {}, `Body: ${type} `, name ? element("code", {}, name) : ""));
    if (name) details.append(shown(`Schema of ${name}`, refs[name]));
    for (const [title, value] of examplesOf(item, refs)) {
      details.append(shown(`Example of ${type}${title}`, value));
    }
  }
  const table = (title, rows) => rows.length && details.append(element("div", { class: "scroll" },
    element("table", {}, element("caption", { class: "soft small" }, title), element("tbody", {}, ...rows))));
  table("Parameters", parameters);
  table("Answers", answers);
  for (const [status, { content }] of Object.entries(operation.responses)) {
    for (const [type, item] of Object.entries(status < "3" ? content ?? {} : {})) {
      for (const [title, value] of examplesOf(item, refs)) {
        details.append(shown(`Example of ${status}, ${type}${title}`, value));
      }
    }
  }
  return details;
}

trying(async () => {
  const api = await ask("/api/openapi.json");
  const groups = new Map();
  for (const [path, methods] of Object.entries(api.paths)) {
    for (const [method, operation] of Object.entries(methods)) {
      const group = operation.tags?.[0] ?? "others";
      if (!groups.has(group)) groups.set(group, []);
      groups.get(group).push(operationItem(path, method, operation, api.components.schemas));
    }
  }
  document.getElementById("operations").replaceChildren(...[...groups].map(([name, items]) =>
    element("section", { class: "stack" }, element("h2", {}, name), ...items)));
});

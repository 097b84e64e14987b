/** The description of the interface, for people. */

import { ask, element, trying } from "./api.js";

function operationItem(path, method, operation, refs) {
  const parameters = [...(operation.parameters ?? [])].map((item) => element("tr", {},
    element("td", {}, element("code", {}, item.name)), element("td", {}, item.in),
    element("td", {}, item.description ?? item.schema?.title ?? "")));
  const answers = Object.entries(operation.responses).map(([status, item]) => element("tr", {},
    element("td", {}, status), element("td", { colspan: 2 }, item.description)));
  const body = operation.requestBody?.content ?? {};
  const details = element("details", { class: "panel" },
    element("summary", {}, element("strong", {}, method.toUpperCase()), " ", element("code", {}, path)),
    element("p", {}, operation.description ?? operation.summary ?? ""));
  for (const [type, { schema }] of Object.entries(body)) {
    const name = schema?.$ref?.split("/").at(-1);
    details.append(element("p", {}, `Body: ${type} `, name ? element("code", {}, name) : ""));
    if (name) {
      details.append(element("details", {}, element("summary", {}, `Schema of ${name}`),
        element("pre", { tabindex: 0 }, JSON.stringify(refs[name], null, 1))));
    }
  }
  const table = (title, rows) => rows.length && details.append(element("div", { class: "scroll" },
    element("table", {}, element("caption", { class: "soft small" }, title), element("tbody", {}, ...rows))));
  table("Parameters", parameters);
  table("Answers", answers);
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

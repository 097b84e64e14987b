/** Turns a token into a cookie that scripts cannot read. */

import { problemOf, trying } from "./api.js";

const form = document.getElementById("form");
const wanted = new URLSearchParams(location.search).get("next") ?? "/";
const next = wanted.startsWith("/") && !wanted.startsWith("//") && !wanted.includes("\\") ? wanted : "/";

form.addEventListener("submit", (event) => {
  event.preventDefault();
  trying(async () => {
    const answer = await fetch("/api/v1/session", {
      method: "POST",
      headers: { Authorization: `Bearer ${form.elements.token.value.trim()}` },
    });
    if (answer.status === 401) throw new Error("The service does not know this token.");
    if (!answer.ok) throw await problemOf(answer);
    location.assign(next);
  });
});
document.getElementById("token").focus();

/** The words of the pages in the language of the session. */

import en from "./texts/en.js";

export const LANGUAGES = Object.freeze(["en", "de", "fr", "es", "tr", "ja"]);

/** Return the texts of a language; English where it is not one of `LANGUAGES`. */
export async function textsOf(language) {
  if (language === "en" || !LANGUAGES.includes(language)) return en;
  return (await import(`./texts/${language}.js`)).default;
}

/** Return the language of the browser, or English where it is not one of `LANGUAGES`. */
export function browserLanguage() {
  const language = navigator.language.slice(0, 2);
  return LANGUAGES.includes(language) ? language : "en";
}

/** Return a text with its gaps filled: "{name}". */
export function fill(text, values) {
  return text.replace(/\{(\w+)\}/g, (_, name) => String(values[name]));
}

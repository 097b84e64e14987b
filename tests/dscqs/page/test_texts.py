"""Every language has every text, with the same gaps."""

from __future__ import annotations

from typing import Any

import pytest

from dscqs.desk import LANGUAGES

OUTLINE = """async (language) => {
  const {textsOf, LANGUAGES} = await import("/texts.js");
  const outline = (value, path) => typeof value === "string"
    ? [[path, (value.match(/\\{\\w+\\}/g) ?? []).sort().join(" "), value.trim() !== ""]]
    : Object.entries(value).flatMap(([key, inner]) => outline(inner, path + "/" + key));
  const known = LANGUAGES.includes(language);
  return {known, outline: outline(await textsOf(language), "")};
}"""


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_language_has_every_text(tab: Any, language):
    english = tab.evaluate(OUTLINE, "en")
    found = tab.evaluate(OUTLINE, language)
    assert found == english
    assert len(found["outline"]) > 130


@pytest.mark.parametrize("language", [name for name in LANGUAGES if name != "en"])
def test_languages_are_not_english_left_over(tab: Any, language):
    same = tab.evaluate(
        """async (language) => {
          const {textsOf} = await import("/texts.js");
          const all = (value) => typeof value === "string" ? [value] :
            Object.values(value).flatMap(all);
          const english = new Set(all(await textsOf("en")));
          return all(await textsOf(language)).filter((text) =>
            text.split(" ").length > 3 && english.has(text));
        }""",
        language,
    )
    assert same == []

"""The languages of reports: a catalogue of translations for each, in `locale`; its keys are the English sentences."""

from __future__ import annotations

import gettext
from pathlib import Path

DOMAIN = "shipfp_rs"
CATALOGUES = Path(__file__).parents[1] / "locale"


def found(catalogues: Path) -> tuple[str, ...]:
    """Return the languages that a folder of catalogues has, English first."""
    return "en", *sorted(path.parts[-3] for path in catalogues.glob(f"*/LC_MESSAGES/{DOMAIN}.mo"))


LANGUAGES = found(CATALOGUES)
"""Every language that a report can be written in."""


def catalogue(language: str) -> gettext.NullTranslations:
    """Return what translates English into one of `LANGUAGES`."""
    if language == "en":
        return gettext.NullTranslations()
    return gettext.translation(DOMAIN, CATALOGUES, [language])

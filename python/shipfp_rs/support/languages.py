"""Languages of reports: one catalogue of translations each, in `locale`, with the English sentences as keys."""

from __future__ import annotations

import gettext
from pathlib import Path

DOMAIN = "shipfp_rs"
CATALOGUES = Path(__file__).parents[1] / "locale"


def found(catalogues: Path) -> tuple[str, ...]:
    """Languages of the catalogues in a folder, English first."""
    return "en", *sorted(path.parts[-3] for path in catalogues.glob(f"*/LC_MESSAGES/{DOMAIN}.mo"))


LANGUAGES = found(CATALOGUES)
"""Languages of reports."""


def catalogue(language: str) -> gettext.NullTranslations:
    """Translations from English into one of `LANGUAGES`."""
    if language == "en":
        return gettext.NullTranslations()
    return gettext.translation(DOMAIN, CATALOGUES, [language])

"""Pictures drawn once, as SVG within the page."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from shipfp_rs.report.curves import curves_csv
from shipfp_rs.report.language import Say
from shipfp_rs.report.markup import link_to, piece

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import Formatter

WIDE = 8.0
"""Width [in] from which on a picture scrolls on a phone, where its text could not be read any more."""
NARROW = 6.4
"""Width of a picture that a phone shows whole, its text larger for that [in]."""
INK = "#010203"
"""Colour of text and axes in a picture; the page replaces it by its own, light or dark."""


class Pictures:
    """Draws pictures as inline SVG, each with identifiers of its own."""

    def __init__(self, say: Say) -> None:
        self._count = 0
        self._say = say

    def draw(
        self,
        panels: int,
        paint: Callable[[Sequence[Axes]], object],
        caption: str,
        *,
        height: float = 2.0,
        width: float = 9.0,
        sharex: bool = True,
        saved: bool = True,
        table: str = "",
    ) -> str:
        """Return a figure element with `panels` axes above each other, painted by `paint`, each that high [in].

        Below it stand links to the same picture as PNG, ink on white, and to what it shows as CSV, the `table` where one
        is given, if it is to be `saved`.
        """
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        style: dict[Any, Any] = {"svg.hashsalt": "shipfp", "figure.facecolor": "none"}
        if width < WIDE:
            style["font.size"] = 12.0
        for part in ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"):
            style[part] = INK
        self._count += 1
        with rc_context(style):
            figure = Figure(figsize=(width, 1.0 + height * panels), layout="constrained")
            axes = figure.subplots(panels, 1, sharex=sharex, squeeze=False)[:, 0]
            for ax in axes:
                ax.patch.set_alpha(0.0)
            paint([*axes])
            self._translate([*axes])
            buffer = io.StringIO()
            figure.savefig(buffer, format="svg", metadata={"Date": None})
            figure.set_layout_engine("none")  # it is laid out
            picture = link_to("image/png", _png(figure)) if saved else ""
            shown = link_to("text/csv", (table or curves_csv([*axes])).encode()) if saved else ""
        svg = Markup(self._inline(buffer.getvalue(), caption))
        return piece("figure", svg, caption, width < WIDE, picture, shown, f"picture-{self._count}")

    def _translate(self, axes: Sequence[Axes]) -> None:
        """Put labels and legends into the report's language and words; titles are names that a user gave."""
        for ax in axes:
            for axis in (ax.xaxis, ax.yaxis) if self._say.language != "en" else ():
                axis.set_major_formatter(_spoken(axis.get_major_formatter(), self._say))
            for text in ax.texts:
                text.set_text(self._say.number(text.get_text()))
            legend = ax.get_legend()
            texts = [ax.xaxis.label, ax.yaxis.label, *(legend.get_texts() if legend is not None else ())]
            for text in texts:
                text.set_text(self._say.label(text.get_text()))

    def _inline(self, svg: str, caption: str) -> str:
        """Strip what only a file of its own needs, take on the page's colour, and make identifiers unique."""
        svg = svg[svg.index("<svg") :]
        svg = re.sub(r"<metadata>.*?</metadata>", "", svg, count=1, flags=re.DOTALL)
        svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg)
        svg = svg.replace(INK, "currentColor")
        svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>picture{self._count}-", svg)
        # A tenth of a point is finer than any screen, and half the size.
        svg = re.sub(r'\bd="[^"]*"', lambda path: re.sub(r"(\.\d)\d+", r"\1", path.group()), svg)
        return svg.replace("<svg ", f'<svg role="img" aria-label="{escape(caption)}" ', 1)


def _spoken(inner: Formatter, say: Say) -> Formatter:
    """Return what labels ticks as `inner` does, with the language's decimal sign."""
    from matplotlib.ticker import Formatter

    class Spoken(Formatter):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return say.number(inner(x, pos))

        def format_ticks(self, values: list[float]) -> list[str]:
            return [say.number(text) for text in inner.format_ticks(values)]

        def get_offset(self) -> str:
            return say.number(inner.get_offset())

    return Spoken()


def _png(figure: Figure) -> bytes:
    """Return the picture on white, in ink."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()

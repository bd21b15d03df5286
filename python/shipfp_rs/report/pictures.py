"""Pictures drawn once, as SVG within the page."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from shipfp_rs.report.markup import piece

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK = "#010203"
"""Colour of text and axes in a picture; the page replaces it by its own, light or dark."""


class Pictures:
    """Draws pictures as inline SVG, each with identifiers of its own."""

    def __init__(self) -> None:
        self._count = 0

    def draw(
        self,
        panels: int,
        paint: Callable[[Sequence[Axes]], object],
        caption: str,
        *,
        height: float = 2.0,
        width: float = 9.0,
        sharex: bool = True,
    ) -> str:
        """Return a figure element with `panels` axes above each other, painted by `paint`, each that high [in].

        Below it stands a link to the same picture as PNG, ink on white.
        """
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        style: dict[Any, Any] = {"svg.hashsalt": "shipfp", "figure.facecolor": "none"}
        for part in ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"):
            style[part] = INK
        self._count += 1
        with rc_context(style):
            figure = Figure(figsize=(width, 1.0 + height * panels), layout="constrained")
            axes = figure.subplots(panels, 1, sharex=sharex, squeeze=False)[:, 0]
            for ax in axes:
                ax.patch.set_alpha(0.0)
            paint([*axes])
            buffer = io.StringIO()
            figure.savefig(buffer, format="svg", metadata={"Date": None})
        return piece("figure", Markup(self._inline(buffer.getvalue(), caption)), caption)

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

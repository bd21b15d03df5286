"""What every figure of a reproduction has: axes with units, a caption, a legend."""

import re
from collections.abc import Sequence
from typing import Any

from shipfp_rs.reproduce.pictures import Picture, painted

UNIT = re.compile(r"\[(rpm|kW|t|V|Nm|kg m\$\^2\$|-|s|1/s|Hz|deg|%)\]$")


def check_figures(
    pictures: Sequence[Picture[Any]], material: Any, *, without_legend: Sequence[str] = ()
) -> None:
    for picture in pictures:
        figure = painted(picture, material)
        labels = [label for ax in figure.axes for label in (ax.get_xlabel(), ax.get_ylabel()) if label]
        assert len(labels) >= (1 if picture.file in without_legend else 2)
        assert all(UNIT.search(label) for label in labels), (picture.file, labels)
        assert figure.get_supxlabel().strip()
        if picture.file not in without_legend:
            assert figure.legends or any(ax.get_legend() for ax in figure.axes), picture.file

"""Plots of studies (matplotlib, `heliograph[analysis]`): at most `PANELS_A_ROW` beside another, of dots `DOTS_A_ROW`.

Names stand below, never over a curve: once for all panels where these show the same, else under each.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from heliograph.errors import FileError
from heliograph_services.cli.studies.study import Done, Dots, Figure, Panel, Study

PANELS_A_ROW: Final = 4
DOTS_A_ROW: Final = 2
# Inches of a panel; of a row of panels, the lower where names stand once below all.
WIDTH_IN: Final = 6.2
ROW_IN: Final = 3.6
ROW_NAMED_IN: Final = 4.9
# Inches of a dot in a condition; of the panel about the conditions; of numbers and label below it.
DOT_IN: Final = 0.11
DOTS_IN: Final = 1.9
LABEL_IN: Final = 0.45


def can_draw() -> bool:
    """Return whether matplotlib is there."""
    try:
        import matplotlib as mpl  # noqa: PLC0415 - an extra
    except ImportError:
        return False
    return bool(mpl.__version__)


def draw(study: Study, done: Sequence[Done], path: Path) -> None:
    """Write a study's plots, one panel beside the other, or its picture.

    Raises:
        FileError: it cannot be written.
    """
    import matplotlib as mpl  # noqa: PLC0415 - an extra

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    drawn = [] if study.panels is None else study.panels(done)
    panels = [panel for panel in drawn if _shows(panel)]
    if study.picture is None and not panels:
        return
    if study.picture is not None:
        figure, axes = plt.subplots(1, 1, figsize=(8.4, 6.9), squeeze=False)
        study.picture(done, axes[0, 0])
        figure.tight_layout()
    else:
        figure = _panels(plt, panels)
    beside = path.with_name(f"{path.stem}.part.png")
    try:
        # Without a date or a version the same figures make the same bytes.
        figure.savefig(beside, dpi=110, metadata={"Software": None})
        os.replace(beside, path)  # noqa: PTH105 - at once
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        plt.close(figure)


def _shows(panel: Panel | Dots) -> bool:
    """Return whether there is anything in a panel."""
    if isinstance(panel, Dots):
        return any(one.value is not None for some in panel.dots.values() for one in some)
    return bool(panel.quoted) or any(curve.x for curve in panel.curves)


def _names(panel: Panel | Dots) -> tuple[str, ...]:
    return tuple(panel.dots) if isinstance(panel, Dots) else tuple(curve.name for curve in panel.curves)


def _height_in(panel: Panel | Dots, alike: bool) -> float:
    if isinstance(panel, Dots):
        return DOTS_IN + DOT_IN * len(panel.rows) * (len(panel.dots) + 1)
    return ROW_IN if alike else ROW_NAMED_IN


def _panels(plt: Any, panels: Sequence[Panel | Dots]) -> Any:
    across = min(len(panels), DOTS_A_ROW if isinstance(panels[0], Dots) else PANELS_A_ROW)
    rows = -(-len(panels) // across)
    alike = len(panels) > 1 and len({_names(panel) for panel in panels}) == 1
    heights = [max(_height_in(one, alike) for one in panels[i * across : (i + 1) * across]) for i in range(rows)]
    figure, axes = plt.subplots(
        rows,
        across,
        figsize=(WIDTH_IN * across, sum(heights)),
        squeeze=False,
        layout="constrained",
        height_ratios=heights,
    )
    named: dict[str, Any] = {}
    # Whoever is in several panels has one colour.
    colours = {name: f"C{i}" for i, name in enumerate(dict.fromkeys(name for one in panels for name in _names(one)))}
    for axis, panel in zip(axes.flat, panels, strict=False):
        if isinstance(panel, Dots):
            _dots(axis, panel, colours)
        else:
            _panel(axis, panel)
        handles, labels = axis.get_legend_handles_labels()
        named.update(zip(labels, handles, strict=True))
        if handles and not alike:
            below = _below(figure, axis) if isinstance(panel, Dots) else axis.transAxes
            at = (0.5, 0.0 if isinstance(panel, Dots) else -0.14)
            axis.legend(fontsize=7, loc="upper center", bbox_to_anchor=at, bbox_transform=below, ncols=3)
    for axis in list(axes.flat)[len(panels) :]:
        axis.set_visible(False)
    if named and alike:
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=len(named))
    return figure


def _below(figure: Any, axis: Any) -> Any:
    """Return the axes' coordinates, but from under the label: panels of dots differ in height."""
    from matplotlib.transforms import ScaledTranslation  # noqa: PLC0415 - an extra

    return axis.transAxes + ScaledTranslation(0.0, -LABEL_IN, figure.dpi_scale_trans)


def _panel(axis: Any, panel: Panel) -> None:
    for curve in panel.curves:
        if curve.x:
            (line,) = axis.plot(curve.x, curve.y, "o-", ms=3, label=curve.name)
            if curve.low:
                axis.fill_between(curve.x, curve.low, curve.high, color=line.get_color(), alpha=0.15)
    for x, y, what in panel.quoted:
        axis.plot([x], [y], "k*", ms=9, label=what)
    if panel.log_x:
        axis.set_xscale("log")
    axis.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)
    axis.grid(alpha=0.3)


def _dots(axis: Any, panel: Dots, colours: dict[str, str]) -> None:
    """Draw the dots of a condition about its line, one below the other."""
    apart = 0.8 / len(panel.dots)
    for i, (name, figures) in enumerate(panel.dots.items()):
        off = (i - (len(panel.dots) - 1) / 2) * apart
        colour = colours[name]
        shown = [(row + off, one) for row, one in enumerate(figures) if one.value is not None]
        axis.plot([], [], "o", ms=4, color=colour, label=name)
        for y, one in shown:
            axis.plot([one.value], [y], _mark(panel, one), ms=4, color=colour)
            if one.low is not None and one.high is not None:
                axis.plot([one.low, one.high], [y, y], "-", lw=1, color=colour)
    for number, (row, x) in enumerate(panel.quoted):
        axis.plot([x], [row], "k*", ms=8, label=None if number else "the paper (quoted)")
    if panel.log_x:
        axis.set_xscale("log")
    axis.set_yticks(range(len(panel.rows)), panel.rows, fontsize=8)
    axis.set_ylim(len(panel.rows) - 0.4, -0.6)
    axis.set(title=panel.title, xlabel=panel.x_label)
    axis.grid(alpha=0.3, axis="x")


def _mark(panel: Dots, one: Figure) -> str:
    """Return the mark of a figure: a bound points to where the value may be."""
    if panel.bounds:
        return "x" if one.unit == "found" else "<"
    return "o"

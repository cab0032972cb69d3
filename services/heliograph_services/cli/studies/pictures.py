"""Plots of studies (matplotlib, `heliograph[analysis]`): panels in rows of at most `PANELS_A_ROW`.

Names stand below, never over a curve: once for all panels where these show the same, else under each.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from heliograph.errors import FileError
from heliograph_services.cli.studies.study import Done, Panel, Study

PANELS_A_ROW: Final = 4
# Inches of a panel; of a row of panels, the lower where names stand once below all.
WIDTH_IN: Final = 6.2
ROW_IN: Final = 3.6
ROW_NAMED_IN: Final = 4.9


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
    panels = [panel for panel in drawn if panel.quoted or any(curve.x for curve in panel.curves)]
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


def _panels(plt: Any, panels: Sequence[Panel]) -> Any:
    across = min(len(panels), PANELS_A_ROW)
    rows = -(-len(panels) // across)
    alike = len(panels) > 1 and len({tuple(curve.name for curve in panel.curves) for panel in panels}) == 1
    size = (WIDTH_IN * across, (ROW_IN if alike else ROW_NAMED_IN) * rows)
    figure, axes = plt.subplots(rows, across, figsize=size, squeeze=False, layout="constrained")
    named: dict[str, Any] = {}
    for axis, panel in zip(axes.flat, panels, strict=False):
        _panel(axis, panel)
        handles, labels = axis.get_legend_handles_labels()
        named.update(zip(labels, handles, strict=True))
        if handles and not alike:
            axis.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)
    for axis in list(axes.flat)[len(panels) :]:
        axis.set_visible(False)
    if named and alike:
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=len(named))
    return figure


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

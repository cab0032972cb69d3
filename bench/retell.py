"""Makes the tables and plots of stored cells anew: `results/STUDY.json` and `.png` from `results/STUDY.jsonl`.

    python bench/retell.py [--check] [STUDY ...]

For a table or a plot that is told otherwise, where what was counted is the same. Heads, looks and cells stay as they
are: they say which code ran. `--check` writes nothing, and fails where a stored result is not that of its cells. A
file whose cells are not all of the study's own is refused: run it (`heliograph evaluate`).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

from heliograph.errors import HeliographError
from heliograph_services.cli.studies.catalogue import STUDIES, load
from heliograph_services.cli.studies.pictures import can_draw, draw
from heliograph_services.cli.studies.stored import read_cells, read_result, result_of, write_result
from heliograph_services.cli.studies.study import Done, Study

RESULTS: Final = Path(__file__).parents[1] / "results"


def told(path: Path) -> tuple[Study, list[Done], dict[str, Any]]:
    """Return study, cells and result of a file of cells.

    Raises:
        ValueError: its cells are not those of the study.
    """
    head, looks, found = read_cells(path)
    study = load(head["study"])
    cells = study.all_cells(head["size"], head["release"])
    if head["version"] != study.version or {cell.key for cell in cells} != set(found):
        raise ValueError(f"{path.name}: not the cells of the study here (its code, or data that are away): run it")
    return study, [found[cell.key] for cell in cells], result_of(study, head, looks, found, cells)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("studies", nargs="*", metavar="STUDY", default=list(STUDIES))
    arguments = parser.parse_args()
    different = []
    for name in arguments.studies:
        try:
            study, done, result = told(RESULTS / f"{name}.jsonl")
        except (HeliographError, ValueError) as error:
            parser.error(str(error))
        path = RESULTS / f"{name}.json"
        # As it is written: numbers of JSON.
        result = json.loads(json.dumps(result))
        if arguments.check:
            different += [name] * (result != read_result(path))
            continue
        write_result(path, result)
        if can_draw():
            draw(study, done, path.with_suffix(".png"))
    if different:
        print(f"not what their cells give: {', '.join(different)}: python bench/retell.py", file=sys.stderr)
    return int(bool(different))


if __name__ == "__main__":
    sys.exit(main())

"""Makes the notebook of the guide "Ten minutes in Python": python python/examples/make_tour.py docs/python.md python/examples/tour.ipynb"""

import json
import re
import sys
from pathlib import Path


def cells(page):
    """The texts and blocks of a page, in order."""
    for kind, block, text in re.findall(r"```(sh|python)\n(.*?)```\n|((?:(?!```(?:sh|python)\n).)+)", page, re.S):
        if kind == "python":
            yield "code", block
        elif kind == "sh":
            yield "code", "".join(f"!{line}\n" for line in block.splitlines())
        elif text.strip():
            yield "markdown", text.replace("](../", "](../../").replace("](pictures/", "](../../docs/pictures/")


def notebook(page):
    """A page as a notebook. The cell that prints a prediction also ends with it, which shows its picture."""
    made = []
    for number, (kind, source) in enumerate(cells(page)):
        source = source.strip("\n")
        if kind == "code" and "\nprint(out)\n" in source:
            source += "\nout"
        cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": source.splitlines(keepends=True)}
        made.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    python = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return json.dumps({"cells": made, "metadata": python, "nbformat": 4, "nbformat_minor": 5}, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(notebook(Path(sys.argv[1]).read_text()))

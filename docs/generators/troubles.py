"""Every failure that the program can tell, from the places that raise it."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import imucalib
from generators.markdown import table
from imucalib import errors

ROOT = Path(inspect.getfile(imucalib)).parent

_HEAD = """# Troubleshooting

Generated from the places of the program that fail. An error says what is wrong, where, and what to do; its exit code
says of which kind it is. In the tables `…` stands for what the message fills in.

| you see | what it means | what to do |
|---|---|---|
| `FAILED`, exit 1 | a limit that you gave (`--max-error`, `--limit`) is broken; the files are written | look at "Good to" and "What to do" of the report |
| `CAUTION`, exit 5 | calibrated; something is left without a name, is not proved by held-out data, or a wrong record waits for your word | decide the record (`--fix`, `--exclude`, `--auto-exclude`); else read what drives the rest, and record data that would tell |
| `weak`, exit 4 | some parameters are not shown by these data; they are near nominal, with that uncertainty | more attitudes; `imucal design` says which |
| an effect that you know of was not found | it is smaller than about 4.7 times the noise, or these positions do not tell it from another | the report's "not testable" and "refused" say which; `--declare EFFECT` takes it as given |
| everything is off by the same factor | the unit or the range was guessed | `imucal inspect FILE` says what was guessed; `--unit`, `--lsb` |
| exit 70 | a fault of the program | the message names the file that holds what is needed to mend it |

`imucal COMMAND --help` has the options; `imucal inspect FILE` shows how a file is read; `--json` gives the error as
`{"error": {"message", "where", "remedy", "exit_code"}}`.
"""

_KINDS = {
    errors.UsageError: "The call is wrong. Nothing was read or written.",
    errors.UnreadableInput: "A file cannot be read, or is not what it must be. Where a file is damaged, what "
    "comes before the damage is kept unless `--strict` is given; `imucal inspect FILE` says what there is.",
    errors.Undetermined: "The data cannot determine what was asked. More or other data are needed, or fewer "
    "parameters.",
    errors.NotConverged: "An iteration ended before its result can be trusted. No file is written.",
    errors.LimitBroken: "The calibration is valid, and beyond a limit of yours.",
}
_ROOMS = {
    "readers": "reading files", "recording": "reading files", "writers": "writing files",
    "rests": "finding rests", "cli": "the command line", "calibrators.lab": "lab",
    "calibrators.actigraph": "actigraph", "calibrators.array": "array", "exports": "export",
    "calibration": "calibration.yaml", "cohort": "batch, collect, fleet", "effects": "effects",
    "inspection": "inspect",
}  # fmt: skip


@dataclass(frozen=True)
class Trouble:
    """One place that fails: kind, words, what to do, and where in the program."""

    kind: str
    what: str
    remedy: str
    room: str


def troubles() -> Iterator[Trouble]:
    """Of every module, in the order of its lines; what has no words of its own is named `…`."""
    kinds = {kind.__name__ for kind in _KINDS}
    for path in sorted(ROOT.rglob("*.py")):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            call = node.exc if isinstance(node, ast.Raise) else node
            if not isinstance(call, ast.Call) or (isinstance(node, ast.Call) and not _fails(node)):
                continue
            kind = ast.unparse(call.func).rpartition(".")[2]
            kind = "UsageError" if kind in ("BadParameter", "fail") else kind
            if kind in kinds and call.args:
                remedy = next((k.value for k in call.keywords if k.arg == "remedy"), None)
                yield Trouble(
                    kind, words(call.args[0]), words(remedy) if remedy else "", _room(module)
                )


def _fails(call: ast.Call) -> bool:
    """Whether it is click's way to end a command: `ctx.fail`, `self.fail`."""
    return isinstance(call.func, ast.Attribute) and call.func.attr == "fail"


def words(node: ast.expr) -> str:
    """What a string says, with … where it is filled in."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(words(v) for v in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return words(node.left) + words(node.right)
    if isinstance(node, ast.IfExp):
        return f"{words(node.body)} / {words(node.orelse)}"
    return "…"


def _room(module: str) -> str:
    near = [name for name in _ROOMS if f"{module}.".startswith(f"{name}.")]
    return _ROOMS[max(near, key=len)] if near else module.partition(".")[0]


def _to_do(remedy: str) -> str:
    return "as the message says" if remedy.strip() == "…" else remedy or "–"


def page() -> str:
    """The page."""
    found, lines = list(troubles()), [_HEAD]
    for kind, text in sorted(_KINDS.items(), key=lambda item: item[0].exit_code):
        own = [t for t in found if t.kind == kind.__name__]
        told = sorted(
            {t for t in own if t.what.strip(" …")}, key=lambda t: (t.room, t.what, t.remedy)
        )
        lines += [f"## Exit code {kind.exit_code}: {kind.__name__}", "", text, ""]
        if len(told) < len(own):
            lines += [f"{len(told)} messages; {len(own) - len(told)} more places repeat one of them, or pass on "
                      "what a file's reader said.", ""]  # fmt: skip
        if told:
            lines += table(("message", "what to do", "in"),
                           [(t.what, _to_do(t.remedy), t.room) for t in told])  # fmt: skip
    return "\n".join(lines)

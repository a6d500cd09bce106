"""Code of a function that a package does not need is removed by one pass per reason; every pass lists edits.

constants  branches, operands and loops that sizes and tables decide; code after return
absent     writes to members that no struct has, calls of kernels that have nothing to compute
once       loops that run once
unread     local variables that nothing names
known      local variables that are a number
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache

from nmpc_codegen.lowering.dialect.c_expressions import Expression, expression, words
from nmpc_codegen.lowering.dialect.constants import Constants
from nmpc_codegen.lowering.dialect.scopes import (
    DECLARATION,
    declarators,
    free_names,
    function_of,
    in_line,
    names_in_code,
    pointers,
)
from nmpc_codegen.lowering.dialect.tree import Edit, Node, edit, margin, whole_lines, wrap_line
from nmpc_codegen.lowering.simplify.idle import without_idle
from nmpc_codegen.lowering.simplify.single import run_once
from nmpc_codegen.lowering.simplify.values import of_known_value

#: A loop that declares its variable; the step of a loop that only counts.
_LOOP = re.compile(r"(?:int|ptrdiff_t) (?P<variable>\w+) = (?P<first>[^,;]+); (?P<condition>[^;]*);(?P<step>.*)")
_SIZE = re.compile(r"\[([^\[\]]*)\]")
_STRING = re.compile("[\"']")
_NAME = re.compile(r"[A-Za-z_]")
#: An operand of a condition that is a number.
_NUMBER = re.compile(r"(?:^|[!(]|&& |\|\| )\d+(?=$|\)| &&| \|\|)")
_COUNTED = re.compile(r" (?:\+\+|--)?(\w+)(?:\+\+|--| [+-]= \w+)?")

Pass = Callable[[str, Node, Constants], Iterator[Edit]]


@lru_cache(maxsize=4096)
def blocks(function: Node) -> tuple[Node, ...]:
    """Return the nodes that contain other nodes."""
    return tuple(node for node in function.walk() if node.kind in ("function", "if", "loop", "block"))


def constants(text: str, function: Node, known: Constants) -> Iterator[Edit]:
    for holder in blocks(function):
        above: Node | None = None
        body = holder.body
        around = _variables(text, body)
        for place, node in enumerate(body):
            if node.kind == "if":
                yield from _simplify_if(text, node, above, around, known)
            elif node.kind == "loop":
                yield from _simplify_loop(text, node, above, known)
            elif node.kind == "leave" and body[place + 1 :]:
                yield Edit(node.end, body[-1].end, "")
            above = node
        end = {"function": "return;", "loop": "continue;"}.get(holder.kind)
        if body and text[body[-1].start : body[-1].end] == end:
            yield Edit(*whole_lines(text, body[-1], None), "")


def _simplify_if(text: str, node: Node, above: Node | None, around: set[str], known: Constants) -> Iterator[Edit]:
    """Yield edits that simplify an `if` whose condition is constant, or one of whose branches is empty."""
    chain = [node]
    while chain[-1].other is not None:
        chain.append(chain[-1].other)
    for place, branch in enumerate(chain):
        whole = in_line(text[slice(*branch.head)])
        value = True if branch.kind == "block" else known.reduce(whole) if _decidable(whole, known) else whole
        empty = not any(n.kind != "comment" for n in branch.body)
        if value is False or (
            empty and branch.other is None and (value is True or not known.effects(expression(whole)))
        ):
            yield _without_branch(text, chain, place, above, around)
            return
        if value is True and branch.kind == "if":
            yield _take(text, branch, place, above, around)
            return
        if isinstance(value, str) and value != whole:
            before = margin(text, branch)
            opening = f"{before}{text[branch.start : branch.head[0]]}{value}) {{"
            yield Edit(branch.start - len(before), branch.inside[0], "\n".join(wrap_line(opening)))


def _decidable(head: str, known: Constants) -> bool:
    """Return True if constants may decide a condition; a condition with a string is kept."""
    return not _STRING.search(head) and bool(known.names(head) or _NUMBER.search(head) or not _NAME.search(head))


def _without_branch(text: str, chain: Sequence[Node], place: int, above: Node | None, around: set[str]) -> Edit:
    """Return the edit that removes one branch of a chain of if and else."""
    branch = chain[place]
    if branch.other is None:
        if place == 0:
            return Edit(*whole_lines(text, branch, above), "")
        return Edit(chain[place - 1].inside[1] + 1, branch.end, "")
    if branch.other.kind == "block" and place == 0:
        return _left(text, branch, branch.other, above, around)
    return Edit(branch.start, branch.other.start, "")


def _take(text: str, branch: Node, place: int, above: Node | None, around: set[str]) -> Edit:
    """Return the edit that ends a chain of branches with a branch that is taken."""
    if place == 0:
        return _left(text, branch, branch, above, around)
    return Edit(branch.start, branch.end, "{" + text[slice(*branch.inside)] + "}")


def _left(text: str, chain: Node, block: Node, above: Node | None, around: set[str]) -> Edit:
    """Return the edit that replaces a chain of if and else by its only remaining block."""
    lifted = _unindent(text, block, around)
    return Edit(chain.start, chain.end, lifted) if lifted else Edit(*whole_lines(text, chain, above), "")


def _variables(text: str, body: Sequence[Node]) -> set[str]:
    """Return the variables that the statements of a block declare."""
    return {n for node in body if node.kind == "statement" for n, _ in declarators(text[node.start : node.end])}


def _unindent(text: str, block: Node, around: set[str]) -> str:
    """Return the content of a block, one step to the left, without the comment after its brace.

    The block keeps its braces if one of its variables has the name of one in ``around``, the variables around it. Its
    own variables are added to ``around``.
    """
    own = _variables(text, block.body)
    if own & around:
        return "{" + text[slice(*block.inside)] + "}"
    around |= own
    start, end = block.inside
    if block.body and block.body[0].kind == "comment" and "\n" not in text[start : block.body[0].start]:
        start = block.body[0].end
    lines = text[start:end].partition("\n")[2].rstrip().split("\n")
    return "\n".join(line.removeprefix("    ") for line in lines).lstrip(" ")


def _simplify_loop(text: str, node: Node, above: Node | None, known: Constants) -> Iterator[Edit]:
    """Yield edits of a loop that never runs or is empty, and of its condition if constants decide operands."""
    head = in_line(text[slice(*node.head)])
    loop = _LOOP.match(head)
    condition = loop["condition"] if loop else head if ";" not in head else ""
    if not condition or not (_decidable(head, known) or all(n.kind == "comment" for n in node.body)):
        return
    first = None if loop is None else known.range(expression(loop["first"]), {})
    variables = {} if loop is None or first is None else {loop["variable"]: first}
    value = known.reduce(condition)
    never = value is False or known.truth(expression(condition), variables) is False
    counted = _COUNTED.fullmatch(loop["step"]) if loop else None
    empty = all(n.kind == "comment" for n in node.body)
    idle = loop is not None and counted is not None and counted[1] == loop["variable"] and empty
    parts = [] if loop is None else [loop["first"], *([] if never else [condition])]
    if (never or idle) and not any(known.effects(expression(part)) for part in parts):
        yield Edit(*whole_lines(text, node, above), "")
    elif isinstance(value, str) and value != condition:
        yield Edit(*node.head, head.replace(condition, value, 1))


def absent(text: str, function: Node, known: Constants) -> Iterator[Edit]:
    """Yield edits that remove statements whose only effect is on something that the package lacks."""
    named = {member for _, member in known.absent} | known.kernels
    if not named:
        return
    structs = pointers(text)
    for holder in blocks(function):
        above: Node | None = None
        for node in holder.body:
            code = in_line(text[node.start : node.end]) if node.kind == "statement" else ""
            if not named.isdisjoint(words(code)) and _is_void(code, structs, known):
                yield Edit(*whole_lines(text, node, above), "")
            above = node


def _is_void(code: str, structs: Mapping[str, str], known: Constants) -> bool:
    if DECLARATION.match(code) or code.startswith("enum "):
        return False
    found = expression(code.removesuffix(";"))
    if found.word == "cast":
        found = found.operands[0]
    if found.kind == "call":
        arguments = _arguments(found)
        if any(map(known.effects, arguments)):
            return False
        place = arguments[0] if found.word in ("memset", "memcpy") else None
        return found.word in known.kernels if place is None else _struct(place, structs, known) == ABSENT
    if found.kind != "assign" or any(map(known.effects, found.operands)):
        return False
    return _struct(found.operands[0], structs, known) == ABSENT


def _arguments(call: Expression) -> list[Expression]:
    """Return the arguments of a call."""
    found = list(call.operands[1:])
    while found and found[0].kind == "binary" and found[0].word == ",":
        found[:1] = found[0].operands
    return found


#: Mark for the struct of a member that no struct has.
ABSENT = "absent"


def _struct(place: Expression, structs: Mapping[str, str], known: Constants) -> str:
    """Return the struct at a place: "" for a number, ABSENT for a member that no struct has, or a part of it."""
    if place.kind == "name":
        return structs.get(place.word, "")
    if place.kind != "member":
        return _struct(place.operands[0], structs, known) if place.operands else ""
    inner = _struct(place.operands[0], structs, known)
    if inner == ABSENT or (inner, place.word) in known.absent:
        return ABSENT
    return known.types.get((inner, place.word), "")


def unread(text: str, function: Node, known: Constants) -> Iterator[Edit]:
    for body in (holder.body for holder in blocks(function)):
        later: set[str] = set()
        for place in reversed(range(len(body))):
            node = body[place]
            code = text[node.start : node.end]
            plain = node.kind == "statement" and not _STRING.search(in_line(code))
            each = declarators(code) if plain else ()
            left: list[str] = []
            effects: list[str] = []
            for name, declarator in reversed(each):
                place_of, _, value = declarator.partition("=")
                acts = any(
                    known.effects(expression(part)) for part in (value, *_SIZE.findall(place_of)) if part.strip()
                )
                if name in later or "(*" in place_of or (acts and (len(each) > 1 or "[" in place_of)):
                    left.insert(0, declarator)
                    later |= names_in_code(declarator)
                elif acts:
                    effects.append(_for_its_effects(value.strip()))
                    later |= names_in_code(value)
            if len(left) < len(each):
                above = body[place - 1] if place else None
                yield _without_variables(text, node, above, left, effects)
            elif not each and node.kind != "comment":
                later |= names_in_code(code)


def _for_its_effects(value: str) -> str:
    """Return a statement that evaluates an expression."""
    return f"(void){value};" if expression(value).kind in ("call", "group") else f"(void)({value});"


def _without_variables(text: str, node: Node, above: Node | None, left: list[str], effects: list[str]) -> Edit:
    """Return the edit of a declaration: the remaining variables, and the effects of the removed values."""
    found = DECLARATION.match(text, node.start)
    assert found is not None
    kept = [f"{found[0]}{', '.join(left)};"] if left else []
    if kept or effects:
        return Edit(node.start, node.end, f"\n{margin(text, node)}".join([*kept, *effects]))
    return Edit(*whole_lines(text, node, above), "")


def known_values(text: str, function: Node, _: Constants) -> Iterator[Edit]:
    edits = (list(of_known_value(text, holder.body, holder.inside[1])) for holder in blocks(function))
    yield from next(filter(None, edits), [])


PASSES: Mapping[str, Pass] = {
    "constants": constants,
    "once": run_once,
    "absent": absent,
    "unread": unread,
    "known": known_values,
}


def simplify(text: str, known: Constants) -> str:
    """Return a function, with its comment, without the code that the package does not need.

    Raises:
        ValueError: the text does not belong to the dialect, or a pass has removed the declaration of a name in use.
    """
    before, changed, text = free_names(text), True, without_idle(text)
    while changed:
        changed = False
        for name, step in PASSES.items():
            while edits := list(step(text, function_of(text), known)):
                text, changed = without_idle(edit(text, edits)), True
                if lost := free_names(text) - before - {"void"} - known.sizes.keys():
                    raise ValueError(f"the pass {name!r} has left {sorted(lost)[0]} without its declaration")
    return _EMPTY.sub(r"\1", text)


#: Empty lines at the ends of blocks, and double empty lines.
_EMPTY = re.compile(r"(\{\n)\n+|\n(?=\n *\}|\n\n)")

"""Several integration steps in lanes: each one as straight-line code from the identity, then a product of matrices.

    [A B] of two steps = A_2 [A_1 B_1] + [0 B_2]

Loops over the columns of [A B] would store the slopes of all columns and lanes, which do not fit into the first cache.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from textwrap import wrap

from nmpc_codegen.ir.kernel import Kernel
from nmpc_codegen.lowering.dialect.tree import WIDTH, wrap_line

#: Most rows of a tile of the product, and its columns; the sums stay in registers.
ROWS, COLUMNS = 4, 6
#: A row of [A B] with at most this part of its elements is left out of the tiles.
FEW = 0.25

INDENT = "    "

#: The columns that each row of a matrix has.
Pattern = Sequence[frozenset[int]]


def product(kernel: Kernel) -> str:
    """lanes_chain(A, S, T): T = A S + [0 B], where [A B] and S, T have nx rows of nz numbers per lane.

    States whose step depends on little, such as those that controls drive alone, have rows of few elements in [A B]
    and, if they stay so from step to step, in S. The tiles leave both out.
    """
    nx, nz = kernel.outputs[-1].size // kernel.outputs[-1].cols, kernel.outputs[-1].cols
    of_step = _pattern(kernel, nx, nz)
    of_sum = _of_all_steps(of_step, nx)
    rows, inner = ([i for i in range(nx) if len(p[i]) > FEW * nz] for p in (of_step, of_sum))
    others = [(n, j) for n in range(nx) if n not in inner for j in sorted(of_sum[n])]
    tiles = [(first, height) for run in _runs(rows) for first, height in _heights(*run)]
    widths = [COLUMNS] * (nz >= COLUMNS) + [nz % COLUMNS] * (nz % COLUMNS > 0)
    texts = [_tile(r, c, _runs(inner), nz) for r in sorted({height for _, height in tiles}) for c in widths]
    lines = [
        "/* T = A S + [0 B], where the rows of A are those of [A B]. */",
        "static void lanes_chain(const lanes_t *A, const lanes_t *S, lanes_t *T)",
        "{",
        *_tile_rows(tiles, nz),
    ]
    for first, last in _runs(rows) if others else ():
        lines += [f"    for (int i = {first}; i < {last}; i++) {{"]
        lines += [f"        T[i * {nz} + {j}] += A[i * {nz} + {n}] * S[{n * nz + j}];" for n, j in others]
        lines += ["    }"]
    for i in sorted(set(range(nx)) - set(rows)):
        terms = [f"A[{i * nz + n}] * S[{n * nz} + j]" for n in sorted(of_step[i]) if n < nx]
        lines += [f"    for (int j = 0; j < {nz}; j++) {{"]
        lines += [f"        T[{i * nz} + j] = {' + '.join(terms) or 'lanes_all(R(0))'};"]
        lines += ["    }"]
    lines += [
        f"    for (int i = 0; i < {nx}; i++) {{",
        f"        for (int j = {nx}; j < {nz}; j++) {{",
        f"            T[i * {nz} + j] += A[i * {nz} + j];",
        "        }",
        "    }",
        "}",
    ]
    zeros = _zeros(kernel)
    if zeros:
        table = wrap_line(f"static const int one_step_zero[{len(zeros)}] = {{ {', '.join(map(str, zeros))} }};")
        texts.insert(0, "\n".join(["/* Elements of [A B] that are zero. */", *table]))
    return "\n\n".join([*texts, "\n".join(lines)])


def offset(place: str, n: int) -> str:
    """Return the place n numbers after another one."""
    return f"{place} + {n}" if n else place


def _declare(kind: str, items: Iterable[str], indent: str = INDENT) -> list[str]:
    """Return a declaration in lines that end between its items."""
    joined = ", ".join(item.replace(" ", "\0") for item in items)
    lines = wrap(f"{kind} {joined};", WIDTH, initial_indent=indent, subsequent_indent=indent + INDENT)
    return [line.replace("\0", " ") for line in lines]


def _pattern(kernel: Kernel, nx: int, nz: int) -> Pattern:
    """Return the elements of [A B] that the kernel stores."""
    last = len(kernel.outputs) - 1
    stored = {element for output, element, _ in kernel.stores if output == last}
    return [frozenset(j for j in range(nz) if i * nz + j in stored) for i in range(nx)]


def _zeros(kernel: Kernel) -> list[int]:
    """Return the elements of [A B] that the kernel does not store."""
    size, cols = kernel.outputs[-1].size, kernel.outputs[-1].cols
    stored = _pattern(kernel, size // cols, cols)
    return [e for e in range(size) if e % cols not in stored[e // cols]]


def _of_all_steps(step: Pattern, nx: int) -> Pattern:
    """Return the elements of [A B] of any number of steps."""
    found = list(step)
    while True:
        longer = [row.union(*(found[n] for n in step[i] if n < nx)) for i, row in enumerate(found)]
        if longer == found:
            return found
        found = longer


def _runs(numbers: Iterable[int]) -> list[tuple[int, int]]:
    """First number of every run of neighbours, and the one behind its last."""
    found: list[tuple[int, int]] = []
    for n in numbers:
        if found and found[-1][1] == n:
            found[-1] = (found[-1][0], n + 1)
        else:
            found.append((n, n + 1))
    return found


def _heights(first: int, last: int) -> Iterator[tuple[int, int]]:
    """First row and height of tiles, whose heights differ by at most one row."""
    rows = last - first
    count = -(-rows // ROWS)
    for n in range(count):
        height = rows // count + (n < rows % count)
        yield first, height
        first += height


def _tile_rows(tiles: Sequence[tuple[int, int]], nz: int) -> Iterator[str]:
    """Loops over the tiles: neighbours of the same height share one."""
    whole = nz // COLUMNS * COLUMNS
    place = 0
    while place < len(tiles):
        first, height = tiles[place]
        count = 1
        while place + count < len(tiles) and tiles[place + count] == (first + count * height, height):
            count += 1
        yield f"    for (int i = {first}; i < {first + count * height}; i += {height}) {{"
        if whole:
            yield f"        for (int j = 0; j < {whole}; j += {COLUMNS}) {{"
            yield f"            lanes_tile_{height}_{COLUMNS}(A + i * {nz}, S + j, T + i * {nz} + j);"
            yield "        }"
        if nz > whole:
            yield f"        lanes_tile_{height}_{nz - whole}(A + i * {nz}, S + {whole}, T + i * {nz} + {whole});"
        yield "    }"
        place += count


def _tile(rows: int, columns: int, inner: Sequence[tuple[int, int]], nz: int) -> str:
    """Return the function of a tile of A S: sums over these rows of S."""
    sums = [[f"s{i}{j}" for j in range(columns)] for i in range(rows)]
    lines = [
        f"LANES_INLINE void lanes_tile_{rows}_{columns}(const lanes_t *A, const lanes_t *S, lanes_t *T)",
        "{",
        *_declare("lanes_t", (f"{name} = {{0}}" for row in sums for name in row)),
    ]
    for first, last in inner:
        lines.append(f"    for (int l = {first}; l < {last}; l++) {{")
        lines += _declare("const lanes_t", (f"b{j} = S[{offset(f'l * {nz}', j)}]" for j in range(columns)), 2 * INDENT)
        for i, row in enumerate(sums):
            lines.append(f"        const lanes_t a{i} = A[{i * nz} + l];")
            lines += [f"        {name} += a{i} * b{j};" for j, name in enumerate(row)]
        lines.append("    }")
    lines += [f"    T[{i * nz + j}] = {name};" for i, row in enumerate(sums) for j, name in enumerate(row)]
    return "\n".join([*lines, "}"])


def calls(kernel: Kernel, suffix: str, x_next: str, S: str) -> tuple[list[str], list[str]]:
    """Return declarations, and statements that compute x_next and S of an interval in lanes from those of its steps."""
    size = kernel.outputs[-1].size
    places = {"x_next": x_next, "S": "one_step"}

    def call(state: str, target: str) -> str:
        named = {**places, "x": state, "S": f"(lanes_t(*)[{kernel.outputs[-1].cols}])({target})"}
        return (
            f"{kernel.name}{suffix}({', '.join(named.get(p.name, p.name) for p in (*kernel.reads, *kernel.writes))});"
        )

    lines = []
    if zeros := len(_zeros(kernel)):
        lines = [f"for (int i = 0; i < {zeros}; i++) {{"]
        lines += ["    one_step[one_step_zero[i]] = before[one_step_zero[i]] = lanes_all(R(0));", "}"]
    lines += [
        call("x", "before"),
        "for (int n = 1; n < STEPS; n++) {",
        f"    {call(x_next, 'one_step')}",
        f"    lanes_chain(one_step, before, {S});",
        "    if (n + 1 < STEPS) {",
        f"        (void)memcpy(before, {S}, sizeof before);",
        "    }",
        "}",
    ]
    return [f"one_step[{size}]", f"before[{size}]"], lines

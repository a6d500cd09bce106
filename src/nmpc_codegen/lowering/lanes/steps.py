"""Several integration steps in lanes: each one as straight-line code from the identity, then a product of matrices.

    [A B] of two steps = A_2 [A_1 B_1] + [0 B_2]

Loops over the columns of [A B] would store the slopes of all columns and lanes, which do not fit into the first cache.
"""

from __future__ import annotations

from nmpc_codegen.ir.kernel import Kernel

#: Rows and columns of a tile of the product, whose sums stay in registers.
ROWS, COLUMNS = 4, 6


def product(nx: int, nz: int) -> str:
    """lanes_chain(A, S, T): T = A S + [0 B], where [A B] and S, T have nx rows of nz numbers per lane."""
    shapes = {(r, c) for r in (min(ROWS, nx), nx % ROWS) for c in (min(COLUMNS, nz), nz % COLUMNS) if r and c}
    texts = [_tile(r, c, nx, nz) for r, c in sorted(shapes)]
    lines = [
        "/* T = A S + [0 B], where the rows of A are those of [A B]. */",
        "static void lanes_chain(const lanes_t *A, const lanes_t *S, lanes_t *T)",
        "{",
        *_tile_rows(0, nx // ROWS * ROWS, ROWS, nz),
        *_tile_rows(nx // ROWS * ROWS, nx, nx % ROWS, nz),
        f"    for (int i = 0; i < {nx}; i++) {{",
        f"        for (int j = {nx}; j < {nz}; j++) {{",
        f"            T[i * {nz} + j] += A[i * {nz} + j];",
        "        }",
        "    }",
        "}",
    ]
    return "\n\n".join([*texts, "\n".join(lines)])


def _tile_rows(first: int, last: int, rows: int, nz: int) -> list[str]:
    """Loops over the tiles of some rows."""
    if first == last:
        return []
    whole, rest = nz // COLUMNS * COLUMNS, nz % COLUMNS
    lines = [f"    for (int i = {first}; i < {last}; i += {rows}) {{"]
    if whole:
        lines += [
            f"        for (int j = 0; j < {whole}; j += {COLUMNS}) {{",
            f"            lanes_tile_{rows}_{COLUMNS}(A + i * {nz}, S + j, T + i * {nz} + j);",
            "        }",
        ]
    if rest:
        lines.append(f"        lanes_tile_{rows}_{rest}(A + i * {nz}, S + {whole}, T + i * {nz} + {whole});")
    return [*lines, "    }"]


def _tile(rows: int, columns: int, nx: int, nz: int) -> str:
    """A tile of A S."""
    sums = [[f"s{i}{j}" for j in range(columns)] for i in range(rows)]
    zeros = ", ".join(f"{name} = {{0}}" for row in sums for name in row)
    lines = [
        f"LANES_INLINE void lanes_tile_{rows}_{columns}(const lanes_t *A, const lanes_t *S, lanes_t *T)",
        "{",
        f"    lanes_t {zeros};",
        f"    for (int l = 0; l < {nx}; l++) {{",
        f"        const lanes_t {', '.join(f'b{j} = S[l * {nz} + {j}]' for j in range(columns))};",
    ]
    for i, row in enumerate(sums):
        lines.append(f"        const lanes_t a{i} = A[{i * nz} + l];")
        lines += [f"        {name} += a{i} * b{j};" for j, name in enumerate(row)]
    lines.append("    }")
    lines += [f"    T[{i * nz + j}] = {name};" for i, row in enumerate(sums) for j, name in enumerate(row)]
    return "\n".join([*lines, "}"])


def calls(kernel: Kernel, suffix: str, x_next: str, S: str) -> tuple[list[str], list[str]]:
    """Declarations, and the statements that compute x_next and S of an interval in lanes from those of its steps."""
    size = kernel.outputs[-1].size
    places = {"x_next": x_next, "S": "one_step"}

    def call(state: str, target: str) -> str:
        named = {**places, "x": state, "S": f"(lanes_t(*)[{kernel.outputs[-1].cols}])({target})"}
        return (
            f"{kernel.name}{suffix}({', '.join(named.get(p.name, p.name) for p in (*kernel.reads, *kernel.writes))});"
        )

    lines = [
        "memset(one_step, 0, sizeof one_step);",
        "memset(before, 0, sizeof before);",
        call("x", "before"),
        "for (int n = 1; n < STEPS; n++) {",
        f"    {call(x_next, 'one_step')}",
        f"    lanes_chain(one_step, before, {S});",
        "    if (n + 1 < STEPS) {",
        f"        memcpy(before, {S}, sizeof before);",
        "    }",
        "}",
    ]
    return [f"one_step[{size}]", f"before[{size}]"], lines

"""These constants were chosen for speed: they change the form of the generated code, never its results.

Each comment ends with the topics of the benchmarks that justify its constant, for `python -m benchmarks --only TOPIC`;
measure a new value there before changing it here.
"""

from __future__ import annotations

#: Number of columns of a dense matrix that are processed together; leading dimensions are rounded up to a multiple.
#: times
PANEL = 4

#: Number of columns of G_k that condensing processes together: more than PANEL, so that S and Q are loaded less often,
#: and not all of them, so that their memory is that of the QP solver. sizes, times
COLUMNS = 8

#: Largest number of nonzeros of S, Q and Q_N together for which straight-line products are written. times
WRITTEN_OUT = 256

#: Factor by which the dense lower triangle of a Hessian must exceed its nonzeros for products over these. times
SPARSE = 4

#: Number of products that are summed before the sum is added to the total of a row. times
TERMS = 4

#: Largest straight-line program, in instructions, that unroll="auto" prints. times
AUTO_INSTRUCTIONS = 2500

#: Operations of an integration step in loops up to which targets with lanes have it as straight-line code.
#: times
STEP_OPERATIONS = 200_000

#: Second derivatives, exact_hessian: up to this number of panels of rows, each panel has a separate loop with constant
#: bounds;
WRITTEN_PANELS = 3
#: the longest tape that is evaluated for all stages of a step at once; f is then printed inline at every stage;
LONGEST_TAPE = 128
#: the number of factors of the rows of one panel that are held in registers;
FACTORS = 12
#: the longest tape, per component of (x, u), that is stored for every stage; a longer one is evaluated again;
TAPE_PER_COMPONENT = 8
#: the number of components that a column of S may reach if it is written as a function of time only.
CLOSED_STATES = 3

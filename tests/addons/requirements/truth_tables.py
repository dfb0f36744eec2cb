"""Truth tables of HPL, judged by hand: each pattern in each scope, with and without a time limit.

``b3`` is a message on /b at 3 s, ``b3:5`` one whose x is 5. The bag goes from 0 to 9 s, or to ``.N``. After it: + met,
- not met, 0 vacuous. Rows of one property are separated by commas.
"""

PATTERNS_IN_SCOPES = """
globally: some /b
    -, b0 +, b9 +, a1 -, a1 b2 +, b1 b2 +, p1 q2 -, a1 a2 a3 -
globally: some /b within 3 s
    -, b0 +, b3 +, b4 -, a1 b2 +, a1 -, b2 b8 +, .2 -, a1 .2 -
after /p: some /b
    0, p1 -, p1 b2 +, b1 p2 -, b1 0, p1 p2 b3 +, b1 p2 b3 +, p9 -
after /p: some /b within 3 s
    0, p1 b4 +, p1 b5 -, p1 p2 b5 -, b1 p2 -, p1 b2 b8 +, p8 -, b1 0
until /q: some /b
    -, b1 q2 +, q1 b2 -, q1 -, b1 +, a1 b2 q3 +, q0 b1 -, b1 q2 b3 q4 +, a1 q2 -
until /q: some /b within 3 s
    b3 q4 +, b4 q5 -, q1 -, q2 b3 -, b1 +, -, b2 q2 +, q2 b2 -
after /p until /q: some /b
    0, p1 b2 q3 +, p1 q2 -, p1 q2 b3 -, p1 b2 q3 p4 b5 q6 +, p1 b2 q3 p4 q5 -, p1 b2 q3 p4 -, p1 b2 +, q1 b2 0
after /p until /q: some /b within 3 s
    p1 b4 q5 +, p1 b5 q6 -, p1 q2 -, p1 b2 q3 p8 +, p8 -, p1 b2 q3 p4 b8 -, b1 0, p1 b2 q3 p4 b7 q8 +
globally: no /b
    +, b0 -, a1 +, a1 b9 -, p1 q2 +, a1 a2 +, b1 b2 -, q1 b2 -
globally: no /b within 3 s
    b3 -, b4 +, +, b0 -, a1 b4 +, b4 b5 +, a1 b2 -, b4 .4 +
after /p: no /b
    0, b1 0, p1 +, p1 b2 -, b1 p2 +, b1 p2 b3 -, p1 a2 +, p1 p2 b3 -
after /p: no /b within 3 s
    p1 b4 -, p1 b5 +, p1 p3 b5 +, b1 0, p1 +, b1 p1 +, p1 b1 -, p1 b5 b6 +
until /q: no /b
    b1 q2 -, q1 b2 +, +, b1 -, q1 +, a1 q2 b3 +, q1 q2 b3 +, a1 b2 q3 -
until /q: no /b within 3 s
    b3 q4 -, b4 q5 +, q1 b2 +, q4 b5 +, b1 -, +, a1 b4 +, b3 .3 -
after /p until /q: no /b
    0, p1 b2 q3 -, p1 q2 b3 +, b1 p2 q3 +, p1 q2 p3 b4 q5 -, p1 q2 b3 p4 q5 b6 +, q1 b2 0, p1 b2 -, p1 p2 q3 b4 +
after /p until /q: no /b within 3 s
    p1 b4 q5 -, p1 b5 q6 +, p1 q2 p3 b6 -, p1 q2 p3 b7 +, b1 0, p1 q2 b2 +, p1 b5 q6 p7 b8 -, p1 +
globally: /a causes /b
    0, b1 0, a1 -, a1 b2 +, b1 a2 -, a1 a2 b3 +, a1 b2 a3 -, a1 b2 a3 b4 +, a1 b1 +, b1 a1 -
globally: /a causes /b within 3 s
    a1 b4 +, a1 b5 -, a1 a3 b5 -, a1 b2 a7 +, a7 -, a1 b2 a6 -, b1 0, a1 a2 b4 +, a1 b2 a4 b8 -
after /p: /a causes /b
    0, p1 0, a1 0, p1 a2 -, p1 a2 b3 +, a1 p2 b3 0, a1 p2 a3 b4 +, p1 b2 0, p1 a2 b3 a4 -, p1 p2 a3 b4 +
after /p: /a causes /b within 3 s
    p1 a2 b5 +, p1 a2 b6 -, a1 p2 0, p1 a8 -, p1 a2 b3 a8 +, p1 a2 p3 b4 +, p1 0, p1 a2 a4 b6 -
until /q: /a causes /b
    a1 q2 -, a1 b2 q3 +, q1 a2 0, a1 -, q1 a2 b3 0, a1 b2 q3 a4 +, 0, b1 q2 0, a1 q2 b3 -
until /q: /a causes /b within 3 s
    a1 b4 q5 +, a1 b5 q6 -, a1 q2 b3 -, q1 a2 0, a7 -, a1 b2 a8 q9 -, a1 b2 a8 +, 0
after /p until /q: /a causes /b
    0, p1 a2 b3 q4 +, p1 a2 q3 b4 -, a1 p2 q3 0, p1 a2 b3 q4 p5 a6 q7 -, p1 a2 b3 q4 p5 a6 b7 +, p1 a2 b3 q4 a5 +,
    p1 q2 a3 0, p1 a2 -
after /p until /q: /a causes /b within 3 s
    p1 a2 b5 q6 +, p1 a2 b6 q7 -, p1 a2 q3 -, p1 a2 b3 q4 p5 a8 +, p1 a8 -, q1 a2 0, p1 q2 p3 a4 b7 +, p1 q2 p3 a4 b8 -
globally: /b requires /a
    0, a1 0, b1 -, a1 b2 +, b1 a2 -, a1 b2 b3 +, a1 b2 a3 b4 +, b1 a2 b3 -, a1 b1 +, b1 a1 -
globally: /b requires /a within 3 s
    a1 b4 +, a1 b5 -, a1 b2 b5 -, a1 a3 b6 +, a1 0, b1 -, a1 b2 a6 b9 +, a1 b4 b4 +
after /p: /b requires /a
    a1 p2 b3 -, p1 a2 b3 +, b1 0, b1 p2 0, p1 b2 -, p1 a2 0, 0, p1 a2 b3 b4 +, b1 p2 a3 b4 +
after /p: /b requires /a within 3 s
    p1 a2 b5 +, p1 a2 b6 -, a1 p2 b3 -, p1 0, b1 p2 a3 b4 +, p1 a2 p3 b5 +, p1 a2 a4 b7 +, p1 b2 -
until /q: /b requires /a
    b1 q2 -, a1 b2 q3 +, q1 b2 0, a1 q2 b3 0, a1 b2 q3 b4 +, 0, b1 -, q1 a2 b3 0
until /q: /b requires /a within 3 s
    a1 b4 q5 +, a1 b5 q6 -, q1 b2 0, a1 q4 b5 0, a1 b2 +, b2 q3 -, a1 a2 b5 q6 +, 0
after /p until /q: /b requires /a
    p1 a2 b3 q4 +, p1 b2 q3 -, a1 p2 b3 q4 -, p1 a2 q3 b4 0, p1 a2 q3 p4 b5 q6 -, p1 a2 b3 q4 p5 a6 b7 +, b1 0, p1 q2 0
after /p until /q: /b requires /a within 3 s
    p1 a2 b5 q6 +, p1 a2 b6 q7 -, p1 a2 b3 q4 p5 b6 -, q1 b2 0, p1 q2 p3 a4 b7 +, p1 q2 p3 a4 b8 -, p1 a2 q3 0,
    p1 a2 a5 b8 +
globally: /a forbids /b
    0, a1 +, b1 0, a1 b2 -, b1 a2 +, a1 b2 a3 -, a1 a2 +, b1 a2 b3 -, a1 b1 -, b1 a1 +
globally: /a forbids /b within 3 s
    a1 b4 -, a1 b5 +, a1 a3 b6 -, a1 b5 a6 +, a9 +, b1 0, a1 a2 b6 +, b1 a2 b6 +
after /p: /a forbids /b
    p1 a2 +, p1 a2 b3 -, a1 p2 b3 0, a1 b2 0, p1 b2 0, p1 b2 a3 +, 0, p1 a2 p3 b4 -
after /p: /a forbids /b within 3 s
    p1 a2 b5 -, p1 a2 b6 +, a1 p2 b3 0, p1 0, p1 a2 a4 b7 -, p1 b2 a3 +, p1 a2 b6 a7 +, a1 0
until /q: /a forbids /b
    a1 b2 q3 -, a1 q2 b3 +, q1 a2 b3 0, a1 +, b1 a2 q3 +, 0, b1 q2 0, a1 b2 -
until /q: /a forbids /b within 3 s
    a1 b4 q5 -, a1 b5 q6 +, a1 q2 b3 +, q1 a2 0, a1 a2 b5 q6 -, a1 +, b1 0, a1 b5 +
after /p until /q: /a forbids /b
    p1 a2 b3 q4 -, p1 a2 q3 b4 +, p1 a2 q3 p4 b5 +, a1 p2 b3 q4 0, p1 q2 a3 b4 0, p1 a2 q3 p4 a5 b6 -, b1 0,
    p1 b2 a3 q4 +
after /p until /q: /a forbids /b within 3 s
    p1 a2 b5 q6 -, p1 a2 b6 q7 +, p1 a2 q3 b4 +, p1 q2 0, p1 a2 q3 p4 a5 b8 -, p1 a2 q3 p4 a5 b9 +, a1 b2 0,
    p1 a2 a3 b6 -
"""

PREDICATES_AND_ALIASES = """
globally: no /b {x > 2}
    0, b1:2 +, b1:3 -, b1:0 b2:3 -, a1:3 0
globally: some (/a {x = 1} or /b {x = 2})
    a1:2 b1:1 -, a1:1 +, b1:2 +, -
globally: /a as A causes /b {x = @A.x}
    a1:1 b2:1 +, a1:1 b2:2 -, a1:1 a2:2 b3:1 -, a1:1 a2:2 b3:1 b4:2 +, a1:1 a2:1 b3:1 +
globally: /a as A causes /b {x = @A.x} within 3 s
    a1:1 a2:2 b4:1 b5:2 +, a1:1 a2:2 b4:1 b6:2 -, a1:1 b2:1 a8:2 +, a8:1 -
globally: /b as B requires /a {x = @B.x}
    a1:1 b2:1 +, a1:1 b2:2 -, a1:1 a2:2 b3:1 b4:2 +, b1:1 a2:1 -
globally: /b as B requires /a {x = @B.x} within 3 s
    a1:1 a2:2 b4:1 +, a1:1 a2:2 b5:1 -, a1:2 a2:1 b5:1 +
globally: /a as A forbids /b {x < @A.x}
    a1:2 b2:2 +, a1:2 b2:1 -, a1:1 a2:2 b3:1 -, a1:1 b2:1 a3:5 +
globally: /a as A forbids /b {x < @A.x} within 3 s
    a1:2 a3:1 b5:1 +, a1:2 a3:1 b4:1 -, a1:2 a3:1 b5:0 -
after /p as P until /q {x = @P.x}: no /b {x > @P.x}
    p1:1 b2:1 +, p1:1 b2:2 -, p1:1 q2:1 b3:2 0, p1:1 q2:2 b3:2 -, p1:1 b2:0 q3:1 p4:5 b5:4 +
globally: /a causes /a
    a1 -, a1 a2 -, 0
globally: /a {x = 1} forbids /a {x = 2}
    a1:1 a2:2 -, a1:2 a2:1 +, a1:2 0
globally: /a requires /a {x = 1}
    a1:1 -, 0
after /p until /p: some /b
    p1 p2 -, p1 b2 p3 b4 p5 -, p1 b2 p3 +, p1 b2 p3 p4 -
globally: some /b {x in {1, 3}}
    b1:1 +, b1:2 -, b1:2 b2:3 +
globally: some /b {x in [1 to 3]!}
    b1:1 +, b1:3 -, b1:2 +
globally: no /b {not (x = 1 implies x > 0) or x / 0 = 1}
    b1:1 +
"""


def rows(text: str) -> list[tuple[str, str, str]]:
    """Return the property, the trace and the sign of each row of a table."""
    found = []
    for line in text.strip().splitlines():
        if not line.startswith(" "):
            hpl = line
            continue
        for row in filter(None, (each.strip() for each in line.split(","))):
            trace, _, sign = row.rpartition(" ")
            found.append((hpl, trace, sign))
    return found


ROWS = rows(PATTERNS_IN_SCOPES) + rows(PREDICATES_AND_ALIASES)

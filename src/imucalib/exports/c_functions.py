"""C of one linear correction: its tables, the functions that apply it, and a test of both.

Fixed point has no long double, no floating point and no shift of a negative number, so that every
compiler since C99 gives the same. Numbers are rounded to the nearest, halves away from zero, and
what does not fit is the largest that does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UsageError


@dataclass(frozen=True)
class Correction:
    """corrected = M raw + b of one sensor (K = 1, `single`) or of K.

    name : what follows `imucal_` in C's names, with an underscore at its end, or empty
    M, b, sd : (K, 3, 3), (K, 3), (K, 3) or None, the last two in `unit`
    fine, coarse : counts that are one `unit` in 32 and in 16 bits; size : `unit`, of a test reading
    """

    name: str
    M: Array
    b: Array
    sd: Array | None
    unit: str
    fine: int
    coarse: int
    size: float
    single: bool


#: Readings that the header tests itself with: the six faces, none, and one between the axes.
TEST_READINGS = np.array([*np.eye(3), *(0.0 - np.eye(3)), np.zeros(3), [0.6, -0.48, 0.64]])

#: One reading's functions: rows of M in Q30 or Q14, bias and reading in counts.
ROUNDED = """\
static inline int32_t imucal_row_q30(const int32_t M[3], int32_t b, const int32_t raw[3]) {
  const int64_t one = (int64_t)1 << 30;
  int64_t v = (int64_t)M[0] * raw[0] + (int64_t)M[1] * raw[1];
  int64_t w = (int64_t)M[2] * raw[2];
  v = v / 2 + w / 2 + (int64_t)b * (one / 2); /* halves: three products may pass 63 bits */
  v = (v >= 0 ? v + one / 4 : v - one / 4) / (one / 2);
  return v > INT32_MAX ? INT32_MAX : v < INT32_MIN ? INT32_MIN : (int32_t)v;
}
static inline int16_t imucal_row_q14(const int16_t M[3], int16_t b, const int16_t raw[3]) {
  int32_t v = (int32_t)M[0] * raw[0] + (int32_t)M[1] * raw[1] + (int32_t)M[2] * raw[2];
  v = (v >= 0 ? v + 8192 : v - 8192) / 16384 + b;
  return v > INT16_MAX ? INT16_MAX : v < INT16_MIN ? INT16_MIN : (int16_t)v;
}
static inline int32_t imucal_near(float v) { return (int32_t)(v < 0 ? v - 0.5f : v + 0.5f); }"""


def tables(one: Correction) -> list[str]:
    """M and b as float, Q30 and Q14, the standard deviation, and what the test expects.

    Raises UsageError when a coefficient passes fixed point.
    """
    fine, coarse = one.b * one.fine, one.b * one.coarse
    # Three products of 16 bits stay in 32 when a row of |M| adds up to less than four.
    if np.abs(one.M).max() >= 1.9999 or np.abs(one.M).sum(axis=2).max() >= 3.99:
        raise UsageError("the coefficients do not fit fixed point", remedy="check the unit")
    if np.abs(fine).max() >= 2**31 - 1 or np.abs(coarse).max() >= 2**15 - 1:
        raise UsageError("the offset does not fit fixed point", remedy="check the unit")
    name, single = f"imucal_{one.name}", one.single
    expected = TEST_READINGS * one.size @ np.swapaxes(one.M, 1, 2) + one.b[:, None]
    lines = [
        f"#define {name.upper()}FINE {one.fine} /* counts of the 32-bit functions that are 1 "
        f"{one.unit} */",
        f"#define {name.upper()}COARSE {one.coarse} /* and of the 16-bit ones */",
        array("float", f"{name}M", one.M, single),
        array("float", f"{name}b", one.b, single),
        array("int32_t", f"{name}M_q30", np.rint(one.M * 2**30), single),
        array("int32_t", f"{name}b_fine", np.rint(fine), single),
        array("int16_t", f"{name}M_q14", np.rint(one.M * 2**14), single),
        array("int16_t", f"{name}b_coarse", np.rint(coarse), single),
    ]
    if one.sd is not None:
        lines.append(array("float", f"{name}sd", one.sd, single))
    return [
        *lines,
        array("float", f"{name}test_raw", TEST_READINGS * one.size),
        array("float", f"{name}test_corrected", expected, single),
    ]


def functions(one: Correction) -> list[str]:
    """Apply in float, 32 and 16 bits, and the test; reading and result may be the same array."""
    name = f"imucal_{one.name}"
    which, imu = ("", "") if one.single else ("int imu, ", "[imu]")
    lines = [
        f"/* {one.unit} to {one.unit} */",
        f"static inline void {name}apply({which}const float raw[3], float corrected[3]) {{",
        "  const float r[3] = {raw[0], raw[1], raw[2]};",
        "  for (int i = 0; i < 3; i++)",
        f"    corrected[i] = {name}M{imu}[i][0] * r[0] + {name}M{imu}[i][1] * r[1] +",
        f"                   {name}M{imu}[i][2] * r[2] + {name}b{imu}[i];",
        "}",
    ]
    for kind, q, scale in (("int32_t", "q30", "fine"), ("int16_t", "q14", "coarse")):
        lines += [
            f"/* {name.upper()}{scale.upper()} counts a {one.unit}, both ways */",
            f"static inline void {name}apply_{scale}({which}const {kind} raw[3], "
            f"{kind} corrected[3]) {{",
            f"  const {kind} r[3] = {{raw[0], raw[1], raw[2]}};",
            "  for (int i = 0; i < 3; i++)",
            f"    corrected[i] = imucal_row_{q}({name}M_{q}{imu}[i], {name}b_{scale}{imu}[i], r);",
            "}",
        ]
    return [*lines, *_self_test(one)]


def _self_test(one: Correction) -> list[str]:
    """Half a count of each reading, the offset, the result and what is due stay below three."""
    name, count = f"imucal_{one.name}", len(TEST_READINGS)
    first, imu = ("", "") if one.single else ("imu, ", "[imu]")
    loop = "" if one.single else f"  for (int imu = 0; imu < {len(one.M)}; imu++)\n"
    scale = name.upper()
    return [
        "/* How many of its components are wrong on this machine: 0 is well. */",
        f"static inline int {name}self_test(void) {{",
        f"  int wrong = 0;\n{loop}  for (int k = 0; k < {count}; k++) {{",
        "    float f[3];\n    int32_t fine[3];\n    int16_t coarse[3];",
        "    for (int i = 0; i < 3; i++) {",
        f"      fine[i] = imucal_near({name}test_raw[k][i] * {scale}FINE);",
        f"      coarse[i] = (int16_t)imucal_near({name}test_raw[k][i] * {scale}COARSE);",
        "    }",
        f"    {name}apply({first}{name}test_raw[k], f);",
        f"    {name}apply_fine({first}fine, fine);",
        f"    {name}apply_coarse({first}coarse, coarse);",
        "    for (int i = 0; i < 3; i++) {",
        f"      const float due = {name}test_corrected{imu}[k][i];",
        "      const float off = f[i] - due;",
        f"      wrong += !(off < {2e-6 * one.size:.1e}f && off > {-2e-6 * one.size:.1e}f);",
        f"      wrong += labs((long)fine[i] - imucal_near(due * {scale}FINE)) > 2;",
        f"      wrong += labs((long)coarse[i] - imucal_near(due * {scale}COARSE)) > 2;",
        "    }\n  }\n  return wrong;\n}",
    ]


def array(kind: str, name: str, values: Array, single: bool = False) -> str:
    """A table of C; of one sensor without the dimension of sensors."""

    def braced(part: Array) -> str:
        inner = [_number(float(v), kind) for v in part] if part.ndim == 1 else map(braced, part)
        return f"{{{', '.join(inner)}}}"

    held = values[0] if single else values
    shape = "".join(f"[{n}]" for n in held.shape)
    return f"static const {kind} {name}{shape} = {braced(held)};"


def _number(value: float, kind: str) -> str:
    return f"{value:.9e}f" if kind == "float" else str(int(value))

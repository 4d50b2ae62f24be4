"""The check of every kernel: the same bits on every instruction set, and numpy's values within 1e-5."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform._native import ISAS, Kernel, library
from gelform._native.kernel import DTYPES

TURNS, MOST, LANES = 12, 40, 16  # draws; the largest size that is drawn, beyond two registers; floats of one


def usable_isas() -> list[str]:
    """The instruction sets that this processor runs."""
    return [isa for isa in ISAS if isa == "base" or library("base").cpu_level() >= ISAS[isa]]


@cache
def declarations() -> dict[str, tuple[str, Kernel]]:
    """Exported name -> the variable that holds its kernel in Python, and the kernel.

    Tests hold those that other kernels call as their steps.
    """
    found = {}
    for path in sorted(
        (*Path(gelform.__file__).parent.rglob("*.py"), *Path(__file__).parent.rglob("test_*.py"))
    ):
        text = path.read_text(encoding="utf-8")
        for node in ast.parse(text).body if " = Kernel(" in text else ():
            if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("Kernel("):
                name, declaration = (ast.literal_eval(argument) for argument in node.value.args)
                found[name] = ast.unparse(node.targets[0]), Kernel(name, declaration)
    return found


def assert_kernel_agrees(
    kernel: Kernel, reference: Callable[..., Any], *arguments: Any, tolerance: float = 1e-5
) -> None:
    """Run a kernel on every instruction set and in numpy.

    `reference` takes the same arguments and returns what the kernel writes into its `out` arrays, in their order (one
    array, or a tuple). An output named `work` is scratch memory and is not compared.
    Without arguments, those of `TURNS` turns are drawn.
    `tolerance` is a fraction of the range of the reference's values.
    """
    draws = [drawn(kernel, np.random.default_rng(turn), turn) for turn in range(0 if arguments else TURNS)]
    for given in draws or [arguments]:
        expected = reference(*_copies(given))
        expected = expected if isinstance(expected, tuple) else (expected,)
        runs = {isa: _written(kernel.on(isa), given) for isa in usable_isas()}
        for isa, outputs in runs.items():
            assert len(outputs) == len(expected)
            for output, baseline, wanted in zip(outputs, runs["base"], expected):
                if output is not None:
                    assert output.tobytes() == baseline.tobytes(), f"{kernel.name}: {isa} differs from base"
                    _assert_close(output, np.asarray(wanted), tolerance, kernel.name)


def _written(kernel: Kernel, arguments: Sequence[Any]) -> list[np.ndarray | None]:
    arguments = _copies(arguments)
    kernel(*arguments)
    return [a for p, a in zip(kernel.parameters, arguments) if p.role == "out" and p.name != "work"]


def _copies(arguments: Sequence[Any]) -> list[Any]:
    return [a.copy() if isinstance(a, np.ndarray) else a for a in arguments]


def _assert_close(got: np.ndarray, wanted: np.ndarray, tolerance: float, name: str) -> None:
    assert got.shape == wanted.shape
    if wanted.dtype.kind in "bui":
        np.testing.assert_array_equal(got, wanted, err_msg=name)
        return
    wanted = wanted.astype(np.float64)
    known = wanted[np.isfinite(wanted)]
    span = max(np.ptp(known), np.abs(known).max()) if known.size else 1.0
    np.testing.assert_allclose(got, wanted, rtol=0, atol=tolerance * span, err_msg=name)


# What a declaration cannot say: sizes that are tied, the least work memory that C takes, values in range.


def up(n, to=LANES):
    return -(-n // to) * to


def half(n):
    return -(-n // 2)


def stepped(s):
    """Pixels in every `step`-th row and column."""
    return -(-s["h"] // s["step"]) * -(-s["w"] // s["step"])


def window(maps, rows):
    """Work of sums over squares of some maps, and of further rows."""
    return lambda s: {"n": (1 + 11 * maps + rows) * (up(s["w"]) + LANES) + LANES}


def stride(s):
    return {"stride": s["w"] + s["stride"] % 3, "rows": s["h"]}


def cells(s):
    c = s["c"] % 4
    return {"c": c, "n": (c + 1) * s["w"] + 4 * s["k"]}


def touched(s):
    r, k = s["r"], s["k"]
    return {"n": max(s["w"] + 4 * k, (r + 2) * (k + 2) + -(-r * k // 4))}


def coarser(s):
    return {"rows": half(s["h"]), "columns": half(s["w"]), "of_run": 3, "n": (s["c"] + 1) * s["w"]}


def blurred(s):
    """A light, taps, and the work of a blur by rows; nodes, and theirs."""
    t, (h, w) = s["t"] % 4 + 1, (s["h"], s["w"])
    own = 3 * w + 6 * (t - 1) + LANES + (2 * t - 1) * up(3 * w)
    return {"s": 3 * w if h % 2 else 3 * (w + h + 1), "t": t, "n": own}


def nodes(s):
    """Nodes over the pixels, and the work of a model's `t` terms or of the forward response's."""
    r, c = (-(-max(s[name] - 1, 1) // LANES) + 1 for name in ("h", "w"))
    forward = 102 * c + 6 * up(s["w"]) + 4 * s["w"]
    return {"r": r, "c": c, "n": 2 * s["t"] * (c + 2) + 3 * up(s["w"]) if "t" in s else forward}


def blurred_at_nodes(s):
    blur = blurred({**s, "t": s["k"]})
    return {**(of := nodes(s)), "s": blur["s"], "k": blur["t"], "n": blur["n"] + of["n"]}


def bent(s):
    t = s["t"] % 5 + 1
    work = s["w"] + 2 * (t - 1) + LANES + (2 * t - 1) * up(s["w"])
    return {"t": t, "n": work, "margin": s["n"] % half(min(s["h"], s["w"]))}


def pressed(s):
    """Five maps and a mask, and the work of the step that takes the most, or runs beyond four maps."""
    sizes, size = bent(s), s["h"] * s["w"]
    sums, sample = window(5, 6)(s)["n"], 2 * -(-size // s["step"])
    most = max(sums, sample, sizes["n"], 5 * s["h"] * half(s["w"]) - 4 * size)
    return {**sizes, "n": 5 * size + -(-size // 4) + most}


def contacts(s):
    """Three maps and labels beside the work of regions."""
    sizes = pressed(s)
    return {**sizes, "n": sizes["n"] + 3 * s["h"] * s["w"] + half(s["h"] * s["w"])}


def over_rest(s):
    cells = s["r"] * s["c"]
    return {"n": 5 * s["r"] * half(s["c"]) + 2 * cells + -(-cells // 4)}


def blocked(s):
    h, w = s["h"] + 15, s["w"] + 15
    return {"h": h, "w": w, "bh": h // 16, "bw": w // 16}


def framed(s):
    """At least three blocks side by side."""
    of = blocked({**s, "w": s["w"] + 32})
    return {**of, "n": max(3 * of["h"], of["h"] + 9 * of["bw"])}


def compared(s):
    """Whole blocks of 1 to 3 px, and the work of the light's fit or of the correlation."""
    h, w, block = s["bh"], s["bw"], s["w"] % 3 + 1
    n = stepped({**s, "h": h, "w": w}) + 1
    return {
        "h": block * h,
        "w": block * w,
        "rounds": s["rounds"] % 4 + 1,
        "n": n,
        "m": max(14 * n, 2 * h * w),
    }


def cosines(s):
    n = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 15, 18, 20, 21][s["half"] % 16]
    return {"half": n, "stride": 2 * n + s["stride"] % 3, "knots": n + 1, "n": (6 * n + 1) * LANES}


def filtered_modes(s):
    x, y = (cosines({"half": s[name], "stride": 0}) for name in ("half_x", "half_y"))
    sides = {f"{name}_{axis}": of[name] for axis, of in (("x", x), ("y", y)) for name in ("half", "knots")}
    h, w = 2 * y["half"], 2 * x["half"]
    return {**sides, "h": h, "w": w, "n": h * w + (3 * max(h, w) + 1) * LANES}


# Sizes that are not free, and numbers that are tied to them.
SIZES = {
    "ball_surface": lambda s: {"points": s["points"] + 1}, "gray_levels": lambda s: {"points": s["points"] + 1},
    "color_around": lambda s: {"n": (2 + 3 * s["r"]) * s["c"]},
    "bent_surface": bent, "cell_means": cells, "coarser_known": coarser, "fill_from_coarser": coarser,
    "cells_over_rest": lambda s: {"n": max(4 * (s["w"] + s["k"]), 3 * s["r"] * s["k"])},
    "color_change": blurred, "hierarchical_from_image": blurred_at_nodes,
    "hierarchical_gradients": nodes, "forward_step": nodes,
    "column_jumps": lambda s: {"w": (w := s["w"] + 8), "n": 3 * (w - 1) + 2 * ((w - 1) // 8)},
    "contact_mask": contacts, "contact_outline": window(2, 2),
    "contact_moments": lambda s: {"m": half(s["h"]) * half(s["w"]), "n": 5 * s["h"] * half(s["w"])},
    "over_rest": over_rest, "depth_variances": over_rest,
    "regions_that_stand": lambda s: {"m": s["n"] + 1},
    "pressure_means": window(5, 6),
    "cosine_filter": filtered_modes,
    "cosine_rows": cosines, "dct_passes": lambda s: {**(c := cosines(s)), "w": 2 * c["half"], "rows": s["h"]},
    "dct_product": stride, "dct_right_side": stride, "dct_sweep": stride,
    "depth_errors": lambda s: {
        "row_ends": s["r"] + 1, "column_ends": s["c"] + 1, "maps": 10, "n": max(10 * s["w"], 2 * s["r"] * s["c"]),
    },
    "distance_from_touched": touched,
    "fit_light": lambda s: {"m": 14 * s["n"], "rounds": s["rounds"] % 4 + 1},
    "follow_patches": lambda s: {"side": (side := s["pixels"] % 9 + 1), "pixels": side**2},
    "gain_of_blocks": compared, "health_blocks": blocked,
    "health_bands": lambda s: {"n": s["n"] + 2}, "health_seam": lambda s: {"m": 3 * s["n"]},
    "health_of_frame": framed, "health_signs": lambda s: {"n": 2 ** s["h"].bit_length()},
    "held_outline": lambda s: {"n": max(5 * s["h"] * half(s["w"]), s["h"] * s["w"])},
    "irradiance": lambda s: {"oversample": (k := s["lights"] % 3 + 1), "h": k * s["rows"], "w": k * s["columns"]},
    "label_regions": lambda s: {"n": 5 * s["h"] * half(s["w"])}, "least_changed_correlation": lambda s: {"m": 2 * s["n"]},
    "lit_blocks": lambda s: {"n": (n := stepped(s) + 1), "m": 2 * n}, "medians_where": lambda s: {"n": 2 * stepped(s)},
    "magnitude_of_share": lambda s: {"n": 2 * -(-s["count"] // s["step"])},
    "means_of_bytes": lambda s: {"h": s["bh"] * s["step"], "w": (w := s["bw"] * s["step"]), "n": 3 * w},
    "motion_rows": lambda s: {"h": s["h"] + 1, "w": s["w"] + 1}, "png_rows": lambda s: {"n": (n := 3 * s["n"]), "r": n + 1},
    "polynomial_gradients": lambda s: {"n": 6 * up(s["w"])},
    "pressed_regions": pressed, "rasterise": lambda s: {"count": s["count"] + 3},
    "rest_anchor": lambda s: {"n": max(9 * s["r"] * half(s["k"]) + 5 * s["r"] * s["k"], 4 * s["w"] + s["r"] * s["k"])},
    "slope_budget": lambda s: {"parts": 8, "count": 21},
    "touched_regions": lambda s: {"m": s["h"] * s["w"], "n": 5 * s["h"] * half(s["w"]) + -(-s["h"] * s["w"] // 4)},
    "slopes_at_rest": lambda s: {"coarse": (c := s["step"] % 3 + 1), "n": 2 * max(stepped(s), stepped({**s, "step": c}))},
    "slopes_over_rest": lambda s: {"n": 3 * s["r"] * s["k"]}, "root_at_pixels": lambda s: {"n": 4 * s["w"]},
}  # fmt: skip


def whole(low, below):
    """Whole numbers; `below` may be the name of a size."""
    return lambda rng, shape, s: rng.integers(low, max(s.get(below, below), low + 1), shape)


def real(low, high):
    return lambda rng, shape, s: rng.uniform(low, high, shape)


def taps(rng, shape, s):
    """Of a symmetric blur, the middle first."""
    sides = rng.uniform(0.05, 1, shape)
    return sides / (2 * sides.sum() - sides[0])


def some(rng, shape, s):
    """Few, half or most of them."""
    return rng.random(shape) < rng.choice([0.1, 0.5, 0.9])


def ends(of):
    return lambda rng, shape, s: np.sort(rng.integers(0, s[of] + 1, shape))


def cell_ends(rng, shape, s):
    """Even ones where there is room."""
    return 4 * np.arange(shape[0]) if 4 * s["c"] <= s["w"] else ends("w")(rng, shape, s)


def parents(rng, shape, s):
    """Of each term an earlier one or none, and a channel."""
    return np.stack([rng.integers(-1, np.arange(shape[0])), rng.integers(0, 3, shape[0])], axis=-1)


def inside(rng, shape, s):
    return np.stack([rng.integers(0, s["h"], shape[0]), rng.integers(0, s["w"], shape[0])], axis=-1)


def filtered(rng, shape, s):
    """Rows of a PNG, each behind the number of its filter."""
    return np.hstack([rng.integers(0, 5, (shape[0], 1)), rng.integers(0, 256, (shape[0], shape[1] - 1))])


GRAY, SIGNED = real(0, 255), real(-1, 1)
# Values that are not free, by the argument's name; others are any unsigned ones, and from 0.05 to 1.
VALUES = {
    **dict.fromkeys(["change", "depth", "gradients", "slopes", "nodes", "table", "bent", "pressure", "mean"], SIGNED),
    **dict.fromkeys(["basis", "shift", "center", "points", "spectrum", "turns", "twists", "texture", "inverse"], SIGNED),
    **dict.fromkeys(["maps", "turns_x", "twists_x", "turns_y", "twists_y", "smooth"], SIGNED),
    **dict.fromkeys(["coarse", "dx", "dy", "normal", "common", "bias", "x"], SIGNED),
    **dict.fromkeys(["light", "untouched", "blocks", "lit"], GRAY), "levels": real(-20, 280),
    "reach": whole(1, 6), "radius": real(1, 2), "taps": taps,
    "parents": parents, "degrees": whole(0, "c"), "corners": whole(-2, MOST), "triangles": whole(0, "count"),
    "deepest": inside, "regions_that_stand deepest": whole(0, 9),
    "labels": whole(0, "n"), "count": whole(0, "n"), "last": whole(0, "n"), "leds": real(1, 9),
    **dict.fromkeys(["pairs", "steps", "doublings", "flat"], whole(1, 4)), "back": whole(0, 2), "rounds": whole(1, 5),
    "dark_to": whole(0, 30), "saturated_from": whole(230, 256), "clipped": whole(0, 2), "widened": real(1, 3),
    "dark": real(0, 50), "bright": real(150, 255),
    "depth_errors rows": ends("h"), "depth_errors columns": cell_ends, "png_rows rows": filtered,
    "irradiance leds": lambda rng, shape, s: rng.uniform(1, 9, shape) * ([1] * 6 + [-0.1] * 3 + [0.3]),
    "ranges": whole(0, 9), "digests": lambda rng, shape, s: rng.integers(-3, 3, shape) * rng.choice([1, 2**60]),
    "scale_weights weights": lambda rng, shape, s: 10 ** rng.uniform(-5, 0, shape) * rng.choice([1, 1e-42, 3e38]),
    "scale_weights anchor": lambda *of: np.maximum(SIGNED(*of), 0), "floor": real(1e-6, 0.1),
    "slopes_at_rest square": real(0.2, 2), "slopes_at_rest share": real(0, 0.5),
    "contact_outline pressure": lambda rng, shape, s: rng.normal(0, 9, shape).clip(0) * some(rng, (shape[0], 1), s),
    "sure_pressure slopes": real(0.05, 1), "pressure_means slopes": real(0.05, 1),
    "slope_budget light": real(0, 1),
    "slope_budget numbers": lambda rng, shape, s: [*rng.uniform(0.05, 1, 20), rng.integers(1, 6)],
    **dict.fromkeys(["pressed_regions depth", "contact_mask depth"], lambda *of: 9 * SIGNED(*of) ** 9),
    "factor": real(0.5, 1), "vertices": real(-1, 40),
    **dict.fromkeys(["dct_sweep splits", "dct_passes splits"], whole(1, "w")), "touched_regions least": real(0.5, 6),
    "gray_levels curve": real(0, 300),
}  # fmt: skip
EITHER = {
    "color_change": {"image", "light"},
    "color_around": {"pixels", "levels"},
    "hierarchical_from_image": {"image", "light"},
}  # one of them is None


def absent_in(kernel, turn):
    """The arguments that are None in a turn through all combinations."""
    optional = [p.name for p in kernel.parameters if p.optional]
    chosen = [set(c) for n in range(len(optional) + 1) for c in itertools.combinations(optional, n)]
    either = EITHER.get(kernel.name)
    chosen = [c for c in chosen if either is None or len(c & either) == 1]
    return chosen[turn * 7 % len(chosen)]


def drawn(kernel, rng, turn):
    """Arguments that it takes."""
    free = {
        name: int(rng.integers(1, 1 + (MOST if name in "hw" or turn % 2 else 6))) for name in kernel.sizes
    }
    sizes = {"step": int(rng.integers(1, 4)), **free}
    sizes |= SIZES.get(kernel.name, lambda s: {})(sizes)
    arguments, absent = [], absent_in(kernel, turn)
    for p in kernel.parameters:
        shape = tuple(int(a) if a.isdigit() else sizes["count" if a == "..." else a] for a in p.axes or ())
        dtype = DTYPES[p.kind]
        any_of_kind = {"b": some, "f": real(0.05, 1)}.get(
            dtype.kind, whole(0, min(256**dtype.itemsize, 2**16))
        )
        draw = VALUES.get(f"{kernel.name} {p.name}", VALUES.get(p.name, any_of_kind))
        value = sizes[p.name] if p.axes is None and p.name in sizes else draw(rng, shape, sizes)
        value = np.asarray(value).astype(dtype)
        arguments.append(None if p.name in absent else value if p.axes is not None else value.item())
    return arguments

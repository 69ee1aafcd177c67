"""The array's sampler beside NumPyro's and PyMC's NUTS: python benchmarks/array/peers.py.

32 IMUs on the setting of paper 001, section IV-A; 93 coordinates and the six numbers of the
motion's covariance. All samplers see the same density of the same data (`array_density.py` is the
peers', in JAX), once in prior standard deviations and once in our frame, the Gaussian at the mode.
Effective sizes and R-hat are computed by the same code for all. The peers may live in another
environment: --python /path/to/its/python.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TUNE, DRAWS, CHAINS = 1000, 500, 4
THREADS = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", default="50,500")
    parser.add_argument("--python", default=sys.executable, help="of the peers' environment")
    parser.add_argument("--peers", default="numpyro,pymc")
    parser.add_argument("--frames", default="prior,frame", help="coordinates of the peers")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds a peer may take")
    parser.add_argument("--peer", nargs=3, metavar=("NAME", "FRAME", "FILE"), help="internal")
    options = parser.parse_args()
    if options.peer:
        run_peer(*options.peer)
        return
    print("| T | sampler | coordinates | CPU s (compiling) | draws | least bulk ESS | R-hat | "
          "ESS / CPU s, without compiling | off in MC errors, largest (rms): means | "
          "sds |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for samples in options.samples.split(","):
        compare(int(samples), options)


def compare(samples: int, options: argparse.Namespace) -> None:
    from samples import MotionPlan, simulated_samples

    from imucalib.calibrators.array.board import read_board
    from imucalib.estimators.array.problem import ArrayPrior
    from imucalib.estimators.array.sampler import sample_positions
    from imucalib.estimators.markov.hmc import Stop

    drawn = read_board("mimu4444").drawn
    rng = np.random.default_rng(100 + samples)
    nominal = drawn + np.vstack([np.zeros(3), rng.normal(size=(len(drawn) - 1, 3)) * 1e-4])
    data = simulated_samples(drawn, MotionPlan(samples=samples), rng)
    prior = ArrayPrior(nominal)
    sample_positions(data.take(np.arange(min(samples, 20))), prior, rng)  # imports, caches
    start = time.process_time()
    ours = sample_positions(data, prior, rng)
    spent = time.process_time() - start
    # The reference for all, ours included: a long run of its own.
    long = sample_positions(data, prior, rng, stop=Stop(ess=6000, most=20_000, block=250))
    row(
        samples=samples,
        name="imucal",
        frame="its own",
        cpu=spent,
        compiling=0.0,
        draws=ours.unknowns,
        long=long.unknowns,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.npz"
        frame = ours.frame
        assert frame is not None
        chosen = ours.prior
        probe = ours.unknowns[0, :8]
        np.savez(
            path, acceleration=data.acceleration, sigma=data.sigma, rate=data.rate,
            precision=data.rate_precision, mean=chosen.mean_vector, sd=chosen.sd_vector,
            motion_scale=chosen.motion_scale, mode=frame.mode, root=frame.root, probe=probe,
            level=frame.posterior.value(probe),
        )  # fmt: skip
        for name in options.peers.split(","):
            for coordinates in options.frames.split(","):
                answer = peer(name, coordinates, path, options)
                if isinstance(answer, str):
                    print(f"| {samples} | {name} | {coordinates} | {answer} | | | | | | |")
                    continue
                with np.load(path.with_suffix(f".{name}.npz")) as found:
                    u = found["draws"]
                row(
                    samples=samples,
                    name=f"{name} {answer['version']}",
                    frame=coordinates,
                    cpu=answer["cpu"],
                    compiling=answer["compiling"],
                    draws=u,
                    long=long.unknowns,
                )


def peer(name: str, frame: str, path: Path, options: argparse.Namespace) -> dict[str, Any] | str:
    command = [options.python, __file__, "--peer", name, frame, str(path)]
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    environment = {**os.environ, **THREADS, "XLA_FLAGS": flags}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=options.limit, env=environment,
            check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"not within {options.limit:.0f} s"
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:]
        return f"not run: {last[0] if last else 'no message'}"
    return dict(json.loads(done.stdout.splitlines()[-1]))


def row(
    samples: int, name: str, frame: str, cpu: float, compiling: float, draws: Array, long: Array
) -> None:
    from imucalib.estimators.markov.convergence import convergence

    draws, long = draws[..., :-6], long[..., :-6]
    found, reference = convergence(draws), convergence(long)
    ess = float(found.bulk.min())
    error = np.hypot(found.mcse, reference.mcse)
    mean = np.abs(draws.mean(axis=(0, 1)) - long.mean(axis=(0, 1))) / error
    # Error of a standard deviation: that of the mean square deviation, over twice the sd.
    squares = [convergence((d - d.mean(axis=(0, 1))) ** 2) for d in (draws, long)]
    sd = [d.std(axis=(0, 1)) for d in (draws, long)]
    spread = np.hypot(*(s.mcse / (2.0 * v) for s, v in zip(squares, sd, strict=True)))
    off = np.abs(sd[0] - sd[1]) / spread
    # Compiling is told from a run of two draws: a rest much shorter than it is not known.
    left = cpu - compiling
    rest = f"{ess / left:.0f}" if left > 0.2 * cpu else "not told"
    print(f"| {samples} | {name} | {frame} | {cpu:.1f} ({compiling:.1f}) | "
          f"{draws.shape[0]} x {draws.shape[1]} | {ess:.0f} | {found.rhat.max():.4f} | "
          f"{ess / cpu:.1f}, {rest} | {mean.max():.1f} ({rms(mean):.2f}) | "
          f"{off.max():.1f} ({rms(off):.2f}) |", flush=True)  # fmt: skip


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def run_peer(name: str, frame: str, file: str) -> None:
    """In the peers' environment: sample, keep the draws as unknowns, print one line of JSON."""
    path = Path(file)
    import jax
    from density import density

    with np.load(path) as kept:
        problem = {key: kept[key] for key in kept.files}
    logp = density(problem)
    scaled = (problem["probe"] - problem["mean"]) / problem["sd"]
    levels = np.array([float(logp(u)) for u in scaled])
    gap = np.ptp(levels - problem["level"])
    if gap > 1e-4:
        raise SystemExit(f"the two densities differ by {gap:.3g}")
    if frame == "frame":
        offset = (problem["mode"] - problem["mean"]) / problem["sd"]
        root = problem["root"] / problem["sd"][:, None]
    else:
        offset, root = np.zeros(len(problem["sd"])), np.eye(len(problem["sd"]))
    target = jax.jit(lambda z: logp(offset + root @ z))
    draws, cpu, compiling = (numpyro_draws if name == "numpyro" else pymc_draws)(
        target, len(offset), frame
    )
    x = problem["mean"] + problem["sd"] * (offset + draws @ root.T)
    np.savez(path.with_suffix(f".{name}.npz"), draws=x)
    from importlib.metadata import version

    print(json.dumps({"cpu": cpu, "compiling": compiling, "version": version(name)}))


def numpyro_draws(target: Any, size: int, frame: str) -> tuple[Array, float, float]:
    import jax
    from numpyro.infer import MCMC, NUTS

    kernel = NUTS(potential_fn=lambda z: -target(z), dense_mass=frame == "prior")

    def spent(tune: int, draws: int) -> tuple[Array, float]:
        begin = time.process_time()
        mcmc = MCMC(kernel, num_warmup=tune, num_samples=draws, num_chains=CHAINS,
                    chain_method="sequential", progress_bar=False)  # fmt: skip
        mcmc.run(jax.random.PRNGKey(0), init_params=jax.numpy.asarray(starts(size, frame)))
        return np.asarray(mcmc.get_samples(group_by_chain=True)), time.process_time() - begin

    _, compiling = spent(1, 1)
    found, total = spent(TUNE if frame == "prior" else TUNE // 4, DRAWS)
    return found, total, min(compiling, total)


def starts(size: int, frame: str) -> Array:
    """(CHAINS, size) overdispersed about the prior mean or the mode."""
    spread = 0.1 if frame == "prior" else 1.3
    return np.random.default_rng(1).normal(size=(CHAINS, size)) * spread


def pymc_draws(target: Any, size: int, frame: str) -> tuple[Array, float, float]:
    import jax
    import pymc as pm
    import pytensor.tensor as pt
    from pytensor.graph.basic import Apply
    from pytensor.graph.op import Op

    both = jax.jit(jax.value_and_grad(target))

    class Slope(Op):
        def make_node(self, z: Any, value: Any) -> Any:
            return Apply(self, [z, value], [pt.dvector()])

        def perform(self, node: Any, inputs: Any, outputs: Any) -> None:
            outputs[0][0] = memory[inputs[0].tobytes()]

    class Level(Op):
        """Keeps the gradient for `Slope`, which is evaluated after it at the same point."""

        def make_node(self, z: Any) -> Any:
            return Apply(self, [pt.as_tensor(z)], [pt.dscalar()])

        def perform(self, node: Any, inputs: Any, outputs: Any) -> None:
            value, slope = both(inputs[0])
            memory.clear()
            memory[inputs[0].tobytes()] = np.asarray(slope)
            outputs[0][0] = np.asarray(value)

        def pullback(self, inputs: Any, outputs: Any, slopes: Any) -> Any:
            return [slopes[0] * Slope()(inputs[0], outputs[0])]

        def grad(self, inputs: Any, slopes: Any) -> Any:
            return [slopes[0] * Slope()(inputs[0], self(inputs[0]))]

    memory: dict[bytes, Array] = {}
    draws, seconds = [], []
    with pm.Model():
        z = pm.Flat("z", shape=size)
        pm.Potential("target", Level()(z))
        for k, begin in enumerate(starts(size, frame)):
            clock = time.process_time()
            found = pm.sample(
                draws=DRAWS, tune=TUNE if frame == "prior" else TUNE // 4, chains=1, cores=1,
                init="adapt_full" if frame == "prior" else "adapt_diag", progressbar=False,
                random_seed=k, compute_convergence_checks=False, initvals=[{"z": begin}],
            )  # fmt: skip
            draws.append(np.asarray(found.posterior["z"][0]))
            seconds.append(time.process_time() - clock)
    # The first chain compiles what the others find compiled.
    return np.stack(draws), sum(seconds), max(seconds[0] - float(np.median(seconds[1:])), 0.0)


if __name__ == "__main__":
    main()

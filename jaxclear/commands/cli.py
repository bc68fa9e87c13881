"""The command line: `jaxclear four-bar`, `antenna` and `guide` run studies, `jaxclear parameters`
lists a scene's numbers with units."""

import argparse
import os
from pathlib import Path


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `jaxclear` command."""
    parser = argparse.ArgumentParser(prog="jaxclear", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    four_bar = commands.add_parser(
        "four-bar",
        help="four-bar with three-dimensional clearance and wear: runs, Monte Carlo, derivatives",
    )
    four_bar.add_argument(
        "--out", type=Path, default=Path("four_bar_study"), help="folder for figures and tables"
    )
    four_bar.add_argument(
        "--samples", type=int, default=256, help="Monte Carlo samples (default 256)"
    )
    four_bar.add_argument(
        "--duration",
        type=float,
        default=5.0,
        help="simulated time of the paper's runs [s] (default 5)",
    )
    four_bar.add_argument(
        "--turns", type=float, default=2.0, help="turns of the crank in the Monte Carlo (default 2)"
    )
    four_bar.add_argument("--quiet", action="store_true", help="no progress bars")
    antenna = commands.add_parser(
        "antenna",
        help="antenna on a satellite with clearance and dry friction: motion, errors of the tip",
    )
    antenna.add_argument(
        "--out", type=Path, default=Path("antenna_study"), help="folder for figures and tables"
    )
    antenna.add_argument(
        "--duration",
        type=float,
        default=4.0,
        help="simulated time of the periodic drive [s] (default 4)",
    )
    guide = commands.add_parser(
        "guide",
        help="slider in a rotating guide: corner forces, switchings, impacts of a small clearance",
    )
    guide.add_argument(
        "--out", type=Path, default=Path("guide_study"), help="folder for figures and tables"
    )
    guide.add_argument(
        "--clearance",
        type=float,
        default=1e-5,
        help="gap of the run with impacts [m] (default 1e-5)",
    )
    guide.add_argument("--quiet", action="store_true", help="no progress bars")
    commands.add_parser("parameters", help="all numbers of the four-bar with unit and meaning")
    options = parser.parse_args(arguments)
    out = getattr(options, "out", None)
    if out is not None and out.exists() and not out.is_dir():
        parser.error(f"--out is {out}, which is a file; give a folder.")
    _keep_compiled_programs()
    if options.command == "parameters":
        import jaxclear as jc

        print(jc.scenes.four_bar().parameters().to_string(index=False))
        return
    if options.command == "guide":
        from jaxclear.commands import guide

        if not options.clearance > 0:
            parser.error(f"--clearance is {options.clearance}; it must be positive.")
        guide.study(options.out, options.clearance, not options.quiet)
        return
    for name, least in (("samples", 16), ("duration", 0.01), ("turns", 0.01)):
        if not getattr(options, name, least) >= least:
            parser.error(f"--{name} is {getattr(options, name)}; it must be at least {least}.")
    if options.command == "antenna":
        from jaxclear.commands.antenna import study as antenna_study

        antenna_study(options.out, options.duration)
        return
    from jaxclear.commands.four_bar import study

    study(options.out, options.samples, options.duration, options.turns, not options.quiet)


def _keep_compiled_programs() -> None:
    """Compiled programs are kept between runs, in $JAX_COMPILATION_CACHE_DIR or the user's cache
    folder.
    """
    import jax

    default = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "jaxclear"
    jax.config.update(
        "jax_compilation_cache_dir", os.environ.get("JAX_COMPILATION_CACHE_DIR", str(default))
    )
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


if __name__ == "__main__":
    main()

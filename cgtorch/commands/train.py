"""`cgtorch-train`: evolve a skill for a domain, in stages or until a goal is reached."""

from collections.abc import Callable, Sequence
from dataclasses import Field, fields
from functools import partial
from pathlib import Path
from typing import Any

import click

from cgtorch.commands import common, completion
from cgtorch.commands.standard_modules import import_from_here
from cgtorch.domains.registry import (
    check_options,
    domain_class,
    full_name,
    is_code,
    settings_class,
    with_name,
)
from cgtorch.ground.errors import CgtorchError, SettingsError
from cgtorch.ground.files import read_json
from cgtorch.runs.settings import NAMES, Goal, RunSettings, defaults_of, help_of, option_of

EXAMPLES = """\b
Examples:
  cgtorch-train --stage S2
  cgtorch-train --stage S3 --seed 1 --run-dir runs/one
  cgtorch-train --resume runs/one
  cgtorch-train --resume runs/one --stage S3 --override population=600
  cgtorch-train --stage auto --target 0.99 --minutes 5 --run-dir runs/auto
  cgtorch-train --stage auto --scenarios general --run-dir runs/general
  cgtorch-train --stage auto --robot fetch --run-dir runs/fetch
  cgtorch-train --stage S3 --world mujoco --run-dir runs/physics
  cgtorch-train --domain gymnasium:CartPole-v1 --run-dir runs/cartpole
  cgtorch-train --domain gymnasium:gymnasium_robotics:FetchReach-v4
  cgtorch-train --domain my_package.cart:Cart --run-dir runs/cart
  cgtorch-train --domain my_package.cart:Cart --data log.csv --transitions 0
  cgtorch-train --domain my_package.cart:Cart --help
  cgtorch-train --stage S1 --actions my_package.actions:Wait
  torchrun --nproc-per-node 4 -m cgtorch.commands.train --stage S3
"""


class DomainCommand(click.Command):
    """A click command that gets the options of a domain once the domain's name is known."""

    def __init__(self, *args: Any, add: Callable[[str], list[click.Option]], **kwargs: Any) -> None:
        """A command; `add` makes the options of the domain with a name."""
        super().__init__(*args, **kwargs)
        self._add = add

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """See `click.Command.parse_args`; the domain is determined first."""
        ctx.meta[completion.DOMAIN] = spec = _domain_named(args)
        import_from_here([spec])
        return super().parse_args(ctx, args)

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """See `click.Command.get_params`."""
        known, made = super().get_params(ctx), f"{completion.DOMAIN}.options"
        try:
            if made not in ctx.meta:
                ctx.meta[made] = self._add(ctx.meta.get(completion.DOMAIN, RunSettings.domain))
        except CgtorchError as e:
            if ctx.resilient_parsing:
                return known
            raise click.UsageError(str(e)) from e
        return [*known[:-1], *ctx.meta[made], known[-1]]


def _domain_named(args: list[str]) -> str:
    """The domain of a command line: the one it names, or that of the run that it names."""
    spec, run = _value(args, "--domain"), _value(args, "--resume")
    if spec is None and run is not None:
        try:
            spec = read_json(Path(run) / "run.json")["settings"]["domain"]
        except (CgtorchError, TypeError, KeyError):
            spec = None  # its faults are reported when the run is opened
        if not isinstance(spec, str) or is_code(spec):
            spec = None
    return RunSettings.domain if spec is None else spec


def _value(args: list[str], option: str) -> str | None:
    for i, word in enumerate(args):
        if word == option and i + 1 < len(args):
            return args[i + 1]
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
    return None


def _options(spec: str) -> list[click.Option]:
    """The options of all settings of a run in a domain, and of its goal."""
    goal, always = (f.name for f in fields(Goal)), (str(p.name) for p in command.params)
    check_options(spec, (*NAMES, *goal, *always))
    own = settings_class(spec)
    skip = ("actions", "data", "domain", "driver", "environment", "target_return")
    defaults, kinds = defaults_of(own), domain_class(spec).kinds if is_code(spec) else ()
    helps = partial(help_of, domain=spec, kinds=kinds if isinstance(kinds, tuple) else ())
    every = (f for kind in (Goal, RunSettings, own) for f in fields(kind) if f.name not in skip)
    return [_option(f, defaults.get(f.name, f.default), helps(f)) for f in every]


def _option(f: Field[Any], default: Any, text: str) -> click.Option:
    """The option of a field made by `cgtorch.domains.settings.option`, with its help."""
    choices, several = f.metadata["choices"], isinstance(f.default, tuple)
    kinds = completion.kinds_of_domain if f.name == "scenarios" else None
    return click.Option(
        [option_of(f.name), f.name],
        type=str if several else type(f.default),
        multiple=several,
        default=default,
        show_default=f.default not in ("", ()),
        help=text,
        shell_complete=completion.one_of(choices) if choices else kinds,
    )


@common.command(
    "cgtorch-train",
    EXAMPLES,
    cls=DomainCommand,
    add=_options,
    short_help="Evolve a skill for a domain.",
)
@click.option(
    "--domain",
    default=RunSettings.domain,
    show_default=True,
    shell_complete=completion.domains,
    help="The domain of the run: tabletop, gymnasium:ENV_ID, gymnasium:module:ENV_ID, the name of "
    "an installed domain, or package.module:Class. Add --help to list the domain's own options.",
)
@click.option(
    "--stage",
    shell_complete=completion.stages,
    help="The last stage to make (the tabletop has S0 to S3), or auto for rounds until the target "
    "is met.  [as the run began; a new run: S2 for the tabletop, auto without stages]",
)
@click.option("--run-dir", type=common.A_PATH, help="The folder of the run.  [runs/seed-N]")
@click.option(
    "--resume", type=common.A_PATH, shell_complete=completion.runs, help="Continue this run."
)
@click.option(
    "--override",
    multiple=True,
    metavar="NAME=VALUE",
    help="With --resume: continue with another value of a setting. Repeat it for several.",
)
@click.option(
    "--driver",
    callback=common.importable,
    help="The driver of a robot in place of the simulated world, as package.module:Class.",
)
@click.option(
    "--data",
    multiple=True,
    type=click.Path(),
    help="Logged transitions and tests from which Γ and C are learned: a CSV or Parquet file, or "
    "the folder of a Minari dataset. Repeat the option for several. With --transitions 0 the run "
    "explores no further.",
)
@click.option(
    "--budget",
    metavar="NAME=N[,NAME=N]",
    help="The largest numbers of motions, tests, looks and episodes to ask of the world, such as "
    "motions=300,tests=200. A run that has spent them ends with the best skill so far.",
)
@click.option(
    "--device",
    default="auto",
    show_default=True,
    shell_complete=completion.one_of(("auto", "cpu", "cuda")),
    help="The device: cpu, cuda, cuda:N, or auto for the fastest. A run may change its device.",
)
@click.option(
    "--processes",
    type=click.IntRange(1, 1024),
    help="Processes on this machine that share the work. Their number does not change the result.  "
    "[one for each core where skills evolve in episodes of a Gymnasium environment, else 1]",
)
@common.number_option(
    "--checkpoint-seconds",
    click.FloatRange(min=0),
    20.0,
    "Seconds between two checkpoints of an evolution. Finished work is kept at once.",
)
@click.pass_context
def command(context: click.Context, /, **options: Any) -> None:
    """Evolve a skill: collect data, fit Γ and C, evolve, and test it in the world.

    Γ is the transition model, which predicts the next percept. C is the success classifier, which
    gives the probability that a skill succeeds. The default domain is a robot that reaches objects
    on a table. Its stages are S0 (objects along the near edge of the table), S1 (left edge), S2
    (right edge) and S3 (far edge). A stage needs all stages before it, and missing ones are made
    first. With --stage auto there are rounds in place of stages: each round tries the skill on
    fresh scenarios and improves it on those that it failed, until the target is reached.
    """
    # Torch takes a second to import, so that help and usage errors come without it.
    with common.importing():
        from cgtorch.commands.training import begin, carry_on
        from cgtorch.domains.domain import rewarded
        from cgtorch.domains.registry import driver_of
        from cgtorch.ground.distributed import together
        from cgtorch.runs.stored_run import read_run
        from cgtorch.training.session import TrainingRequest

    default = click.core.ParameterSource.DEFAULT
    given = {name for name in options if context.get_parameter_source(name) is not default}
    own = settings_class(context.meta[completion.DOMAIN])
    of_domain = {f.name for f in fields(own)}
    settings = {*NAMES, *of_domain} & set(options) - {"actions", "domain", "driver"}
    wanted = {name: options[name] for name in given & settings}
    aims = {f.name: options[f.name] for f in fields(Goal) if f.name in given}
    Goal(**aims)  # which checks them
    overrides = _overrides(context, {*NAMES, *of_domain}, options["override"])
    how = {name: options[name] for name in ("stage", "device", "checkpoint_seconds")}
    budget = _budget(options["budget"])

    def request(returns: bool) -> TrainingRequest:
        if returns and "target" in aims and "target_return" in of_domain:
            wanted["target_return"] = aims.pop("target")
        return TrainingRequest(goal=aims, budget=budget, **how)

    named = own(**{name: wanted[name] for name in {"wrappers", "reward"} & set(wanted)})
    actions, domain = options["actions"], options["domain"]
    shown = options["quiet"], options["processes"]
    domain = full_name(domain, with_name(domain, named))
    if options["resume"]:
        if "run_dir" in given:
            raise SettingsError("--run-dir cannot change in a run that has begun; leave it out")
        spec = domain if "domain" in given else None
        with together():
            with common.waiting(f"loading {options['resume']}", options["quiet"]):
                run = read_run(options["resume"], actions, spec, options["driver"] or None)
            asked = request("target_return" in of_domain and rewarded(run.domain))
            carry_on(run, wanted, overrides, asked, *shown)
        return
    if overrides:
        raise SettingsError("--override is for a run that has begun; add --resume RUN")
    asked = request(not wanted.get("success"))
    domain_settings = own(**{k: v for k, v in wanted.items() if k in of_domain})
    values = {name: options[name] for name in settings & set(NAMES)}
    driver = options["driver"] or driver_of(domain)
    run_settings = RunSettings(**values, actions=tuple(actions), domain=domain, driver=driver)
    folder = options["run_dir"] or Path("runs") / f"seed-{run_settings.seed}"
    with together():
        begin(folder, run_settings, domain_settings, asked, *shown)


def _budget(text: str | None) -> dict[str, float]:
    """Limits by name, from NAME=N,NAME=N; SettingsError for others."""
    from cgtorch.ground.asked import NAMES as ASKED

    found = {}
    for word in (text or "").split(",") if text else ():
        name, _, number = word.strip().partition("=")
        if name not in ASKED or not number.isdecimal():
            raise SettingsError(
                f"--budget {word!r:.40} is no limit; give NAME=N with one of {', '.join(ASKED)}, "
                "such as motions=300,tests=200"
            )
        found[name] = float(number)
    return found


def _overrides(context: click.Context, known: set[str], words: Sequence[str]) -> dict[str, Any]:
    """Settings by name from NAME=VALUE, parsed like their options."""
    options = {option.name: option for option in context.command.get_params(context)}
    found = {}
    for word in words:
        name, _, text = word.partition("=")
        name = name.removeprefix("--").replace("-", "_")
        if "=" not in word or name not in known or name not in options:
            raise SettingsError(
                f"--override {word!r:.40} names no setting; give NAME=VALUE, such as population=600"
            )
        value = options[name].type.convert(text, options[name], context)
        found[name] = (value,) if options[name].multiple else value
    return found


main = partial(common.run_program, command)

if __name__ == "__main__":
    main()

"""``depthsr dscqs simulate``: a test gone through by simulated assessors."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from service.cli_dscqs_tests import add_verbose
from service.console import EXIT_DONE, EXIT_FAILURE
from service.terminal import add_server, token_of


def add_simulate(subcommands: Any) -> None:
    """Add the subcommand to ``dscqs``."""
    parser = subcommands.add_parser(
        "simulate",
        help="let simulated assessors go through a test over HTTP",
        description="Make a test of a plan on a service, and let simulated assessors go through "
        "it over HTTP, all at the same time. A grade is the true quality of the condition, plus "
        "the content, the assessor's bias and noise (all normal), or with the probability of a "
        "lapse any number. Their votes are compared with what the service stored.",
    )
    parser.add_argument("plan", type=Path, metavar="PLAN", help="plan (YAML or JSON)")
    parser.add_argument(
        "--assessors", type=int, default=16, metavar="N", help="on each display (default: 16)"
    )
    parser.add_argument(
        "--quality", type=_quality, metavar="NAME=N,...",
        help="true grade of conditions, 0 to 100 (default: reference 80, others 40 to 75)",
    )  # fmt: skip
    for name, default, said in (
        ("content-sd", 4.0, "standard deviation between contents [grades, 0 to 100]"),
        ("bias-sd", 6.0, "standard deviation between assessors [grades, 0 to 100]"),
        ("noise-sd", 8.0, "standard deviation of a grade [grades, 0 to 100]"),
        ("lapse", 0.02, "probability of a grade without thought, 0 to 1"),
        ("speed", 20.0, "times faster than people"),
    ):
        parser.add_argument(
            f"--{name}", type=float, default=default, metavar="N",
            help=f"{said} (default: {default:g})",
        )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="of the grades (default: 1)"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="votes to write (CSV)")
    add_server(parser, "operator's token")
    add_verbose(parser)
    parser.set_defaults(command=_run)


def _quality(text: str) -> dict[str, float]:
    found = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{part!r} is not NAME=N") from None
    return found


def _run(arguments: argparse.Namespace) -> int:
    from dscqs.errors import PlanError
    from dscqs.plan import plan_to_dict
    from dscqs.simulated import AssessorModel, spread_quality
    from pipeline.media.files import check_writable, write_atomic
    from service.dscqs_client import operator_client
    from service.plan_files import read_plan
    from service.simulate import simulate, unlike

    if arguments.output is not None:
        check_writable(arguments.output)
    if arguments.assessors < 1 or not arguments.speed > 0:
        raise PlanError("--assessors and --speed: must be above 0")
    plan = read_plan(arguments.plan)
    model = AssessorModel(
        quality={**spread_quality(plan.reference, plan.conditions), **(arguments.quality or {})},
        content_sd=arguments.content_sd, bias_sd=arguments.bias_sd, noise_sd=arguments.noise_sd,
        lapse=arguments.lapse, seed=arguments.seed,
    )  # fmt: skip
    with operator_client(arguments.server, token_of(arguments)) as operator:
        test = operator.make_test(plan_to_dict(plan))
        who = [
            (f"sim{number + 1:03d}", display)
            for display in plan.displays
            for number in range(arguments.assessors)
        ]
        links = {pair: operator.invite(test, *pair) for pair in who}
        measured = simulate(arguments.server, plan, links, model, speed=arguments.speed)
        votes = operator.votes_csv(test)
    if arguments.output is not None:
        write_atomic(arguments.output, votes.encode())
    lost, foreign = unlike(measured, votes)
    sys.stdout.write(
        f"test {test}: {len(who)} sessions, {measured.votes.total()} votes in "
        f"{measured.seconds:.1f} s; lost {lost}, not given {foreign}\n"
        f"round trip of a vote: median {measured.percentile(0.5) * 1e3:.1f} ms, "
        f"p99 {measured.percentile(0.99) * 1e3:.1f} ms, "
        f"longest {max(measured.round_trips_s) * 1e3:.1f} ms\n"
    )
    return EXIT_FAILURE if lost or foreign else EXIT_DONE

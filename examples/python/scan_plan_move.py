"""Scans the part in the cell, plans how it reaches a target, moves it after a confirmation and scans it again.

    python3 scan_plan_move.py --deflection-deg 0.2 --pitch-deg 0 --y-c0-mm 0 --z-c0-mm 5

Ctrl-C stops every device of the cell. This is an operational stop: emergency stop and guards belong to the machine.
The exit code is 0 if the part was moved and measured again, 3 without a confirmation, 130 after Ctrl-C, 1 for anything
else. Try it with `coaxis demo`, whose cell is simulated.
"""

from __future__ import annotations

import argparse
import signal
import sys
from typing import Optional

from coaxis_client import Client, CoaxisError, Lease, Measurement, Plan, Target

DONE, FAILED, NOT_CONFIRMED, INTERRUPTED = 0, 1, 3, 130
SCAN_TIMEOUT_S = 300.0
MOVE_MARGIN_S = 120.0
NUMBERS = ("deflection_deg", "pitch_deg", "y_c0_mm", "z_c0_mm")


def main() -> int:
    arguments = read_arguments()
    service = Client(arguments.url)
    target = Target(arguments.deflection_deg, arguments.pitch_deg, arguments.y_c0_mm, arguments.z_c0_mm)
    try:
        with service.lease("scan_plan_move.py", ttl_s=arguments.lease_s) as lease:
            try:
                return align(service, lease, target, arguments)
            except KeyboardInterrupt:
                # Before the lease is given back: nothing may delay the stop.
                stop(service)
                return INTERRUPTED
    except KeyboardInterrupt:
        stop(service)
        return INTERRUPTED
    except CoaxisError as error:
        print(error, file=sys.stderr)
        print(f"the state of the cell: {state_of(service)}", file=sys.stderr)
        return FAILED


def read_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Scans the part in the cell, moves it to a target and scans it again.")
    parser.add_argument("--url", default="http://127.0.0.1:8080", help="address of the service (default %(default)s)")
    parser.add_argument("--deflection-deg", type=float, required=True, help="target: rotation of the axis towards +Y")
    parser.add_argument("--pitch-deg", type=float, required=True, help="target: rotation of the axis towards +Z")
    parser.add_argument("--y-c0-mm", type=float, required=True, help="target: y of the axis in the plane x = 0")
    parser.add_argument("--z-c0-mm", type=float, required=True, help="target: z of the axis in the plane x = 0")
    parser.add_argument("--recipe", help="name of a recipe that the service has stored")
    parser.add_argument("--speed-ratio", type=float, default=1.0, help="share of the greatest speeds (default %(default)s)")
    parser.add_argument("--lease-s", type=float, default=10.0, help="time to live of the lease (default %(default)s)")
    parser.add_argument("--yes", action="store_true", help="move without asking")
    return parser.parse_args()


def align(service: Client, lease: Lease, target: Target, arguments: argparse.Namespace) -> int:
    for manipulator in ("m1", "m2"):
        service.enable(manipulator, lease)
    before = scan(service, lease, arguments.recipe)
    if before is None:
        return FAILED
    show(before, target)
    plan = service.plan(before.id, target, speed_ratio=arguments.speed_ratio)
    show_plan(plan)
    if not (arguments.yes or confirmed()):
        print("nothing was moved")
        return NOT_CONFIRMED
    move = service.execute(plan.id, lease)
    print(f"moves ({move.id}); Ctrl-C stops")
    move = service.wait_move(move.id, timeout_s=plan.duration_s + MOVE_MARGIN_S, lease=lease)
    if move.state != "done":
        reason = f": {move.ending.code}: {move.ending.detail}" if move.ending else ""
        print(f"the move has ended as {move.state}{reason}", file=sys.stderr)
        return FAILED
    after = scan(service, lease, arguments.recipe)
    if after is None:
        return FAILED
    show(after, target)
    return DONE


def scan(service: Client, lease: Lease, recipe: Optional[str]) -> Optional[Measurement]:
    """A measurement with a pose, or None after the reason was printed."""
    measured = service.measure_with_sensor(lease, recipe=recipe)
    print(f"scans ({measured.id})")
    measured = service.wait_measurement(measured.id, timeout_s=SCAN_TIMEOUT_S, lease=lease)
    reason = measured.refusal or measured.failure
    if reason is not None or measured.pose is None:
        words = f"{reason.code}: {reason.detail}" if reason else "it has no pose, or several parts"
        print(f"the measurement is {measured.verdict or measured.state}: {words}", file=sys.stderr)
        return None
    return measured


def show(measured: Measurement, target: Target) -> None:
    pose, uncertainty = measured.pose, measured.uncertainty
    print(f"{'':15} {'measured':>10} {'target':>10} {'error':>10}   uncertainty (k = 2)")
    for name in NUMBERS:
        value, wanted = getattr(pose, name), getattr(target, name)
        expanded = getattr(uncertainty, name)
        if value is None or expanded is None:
            print(f"{name:15} is not known, because the axis is not along the rail")
        else:
            print(f"{name:15} {value:10.4f} {wanted:10.4f} {value - wanted:+10.4f}   ± {expanded:.4f}")


def show_plan(plan: Plan) -> None:
    print(f"plan {plan.id}: {plan.duration_s:.1f} s, strain {plan.strain_mm:.3f} mm, valid until {plan.expires_at}")
    for manipulator, axes in sorted(plan.document["axes"].items()):
        for axis, travel in sorted((key, value) for key, value in axes.items() if isinstance(value, dict)):
            unit = "deg" if "travel_deg" in travel else "mm"
            start, end = travel[f"from_{unit}"], travel[f"to_{unit}"]
            print(f"  {manipulator}.{axis}  {start:9.3f} -> {end:9.3f} {unit}, travel {travel[f'travel_{unit}']:+.3f}")


def confirmed() -> bool:
    try:
        return input("Move the part? Type yes to move: ").strip().lower() == "yes"
    except EOFError:
        return False


def stop(service: Client) -> None:
    """Sends the stop. A second Ctrl-C must not interrupt it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        report = service.stop()
    except CoaxisError as error:
        print(f"THE STOP WAS NOT CONFIRMED: {error}. Use the stop of the machine.", file=sys.stderr)
        return
    if report.confirmed:
        print("stopped: every device was seen at rest", file=sys.stderr)
    else:
        axes = ", ".join(report.unconfirmed_axes) or "the stage or the sensor"
        print(f"the stop was sent; not seen at rest yet: {axes}. The cell is {state_of(service)}.", file=sys.stderr)


def state_of(service: Client) -> str:
    try:
        cell = service.cell()
    except CoaxisError as error:
        return f"unknown: {error}"
    return ", ".join([cell.state, *(f"{fault.code}: {fault.detail}" for fault in cell.faults)])


if __name__ == "__main__":
    sys.exit(main())

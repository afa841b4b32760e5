"""Measures a scan file with a recipe, prints the result and appends a line for each part to a CSV file.

    python3 measure_and_store.py scan.ply --recipe shaft --request-id part-4711 --csv results.csv

The exit code is that of `coaxis measure`: 0 accepted, 2 refused, 1 anything else. Running it again with the same
`--request-id` measures nothing twice and writes no second line.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from pathlib import Path
from typing import Dict, Iterable, List, Optional, Tuple

from coaxis_client import Client, CoaxisError, Measurement, Part, Profile

ACCEPTED, FAILED, REFUSED = 0, 1, 2
POSE = ("deflection_deg", "pitch_deg", "y_c0_mm", "z_c0_mm", "radius_mm")
COLUMNS = [
    "id", "created_at", "file", "request_id", "recipe", "part", "verdict", "refusal", "warnings", "profiles_valid",
    "profiles_total", *POSE, *(f"u_{name}" for name in POSE), "coverage_factor", "u_scope", "scan_sha256",
]  # fmt: skip


def main() -> int:
    arguments = read_arguments()
    service = Client(arguments.url)
    options = dict(option.split("=", 1) for option in arguments.option)
    try:
        measured = service.measure_file(
            arguments.scan, recipe=arguments.recipe, request_id=arguments.request_id, options=options
        )
        show(measured)
        show_rejected(service.profiles(measured.id))
        store(arguments.csv, measured, arguments.scan.name, arguments.request_id)
    except (CoaxisError, OSError) as error:
        print(f"{arguments.scan}: {error}", file=sys.stderr)
        return FAILED
    return ACCEPTED if measured.accepted else REFUSED


def read_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Measures a scan file and appends the result to a CSV file.")
    parser.add_argument("scan", type=Path, help="the scan file, in any format that coaxis reads")
    parser.add_argument("--url", default="http://127.0.0.1:8080", help="address of the service (default %(default)s)")
    parser.add_argument("--recipe", help="name of a recipe that the service has stored")
    parser.add_argument("--request-id", help="number of the part: a repetition with the same id measures nothing twice")
    parser.add_argument("--csv", type=Path, default=Path("results.csv"), help="file to append to (default %(default)s)")
    parser.add_argument(
        "--option", action="append", default=[], metavar="KEY=VALUE", help="query parameter, such as format=ply or unit=um"
    )
    arguments = parser.parse_args()
    if any("=" not in option for option in arguments.option):
        # argparse itself would end with 2, which means refused here.
        parser.exit(FAILED, "--option needs KEY=VALUE, such as --option format=ply\n")
    return arguments


def show(measured: Measurement) -> None:
    print(f"{measured.id}: {measured.verdict}" + (" (the answer of an earlier request)" if measured.replayed else ""))
    if measured.refusal and not measured.parts:
        print(f"  {measured.refusal.code}: {measured.refusal.detail}")
    for part in measured.parts:
        if part.name:
            print(f"{part.name}: {part.verdict}")
        if part.refusal:
            print(f"  {part.refusal.code}: {part.refusal.detail}")
        if part.pose and part.uncertainty:
            for name in POSE:
                value, expanded = getattr(part.pose, name), getattr(part.uncertainty, name)
                if value is not None and expanded is not None:
                    label, unit = name.rsplit("_", 1)
                    print(f"  {label:10} {value:10.5f} ± {expanded:.5f} {'°' if unit == 'deg' else unit}")
            print(f"  k = {part.uncertainty.coverage_factor:g}, {part.uncertainty.scope}")
        print(f"  {part.profiles.valid_count} of {part.profiles.total_count} profiles are valid")
        for warning in part.warnings:
            print(f"  warning {warning.code}: {warning.detail}")


def show_rejected(profiles: Iterable[Profile]) -> None:
    """Prints the rejected profiles: neighbours with the same reason on one line."""
    for first, last in runs(profiles):
        where = f"profile {first.index}" if first is last else f"profiles {first.index} to {last.index}"
        print(f"  {where}, x = {first.x_mm:.1f} to {last.x_mm:.1f} mm: {first.reason}")


def runs(profiles: Iterable[Profile]) -> List[Tuple[Profile, Profile]]:
    found: List[Tuple[Profile, Profile]] = []
    for profile in profiles:
        if profile.verdict == "valid":
            continue
        if found and found[-1][1].index + 1 == profile.index and found[-1][1].reason == profile.reason:
            found[-1] = (found[-1][0], profile)
        else:
            found.append((profile, profile))
    return found


def row(measured: Measurement, part: Part, file_name: str, request_id: Optional[str]) -> Dict[str, object]:
    values: Dict[str, object] = {
        "id": measured.id,
        "created_at": measured.created_at,
        "file": file_name,
        "request_id": request_id,
        "recipe": measured.recipe_name,
        "part": part.name,
        "verdict": part.verdict,
        "refusal": part.refusal.code if part.refusal else None,
        "warnings": " ".join(warning.code for warning in part.warnings),
        "profiles_valid": part.profiles.valid_count,
        "profiles_total": part.profiles.total_count,
        "scan_sha256": measured.scan_sha256,
    }
    for name in POSE:
        values[name] = getattr(part.pose, name) if part.pose else None
        values[f"u_{name}"] = getattr(part.uncertainty, name) if part.uncertainty else None
    if part.uncertainty:
        values.update(coverage_factor=part.uncertainty.coverage_factor, u_scope=part.uncertainty.scope)
    return values


def store(path: Path, measured: Measurement, file_name: str, request_id: Optional[str]) -> None:
    """Appends the parts of the measurement, unless the file has this measurement already."""
    with path.open("a+", newline="", encoding="utf-8") as file:
        file.seek(0)
        lines = csv.DictReader(file)
        if lines.fieldnames is not None and list(lines.fieldnames) != COLUMNS:
            raise OSError(f"{path} has other columns than this program writes; name another file with --csv")
        if any(line["id"] == measured.id for line in lines):
            return
        file.seek(0, os.SEEK_END)
        writer = csv.DictWriter(file, COLUMNS)
        if file.tell() == 0:
            writer.writeheader()
        writer.writerows(row(measured, part, file_name, request_id) for part in measured.parts)
        file.flush()
        os.fsync(file.fileno())


if __name__ == "__main__":
    sys.exit(main())

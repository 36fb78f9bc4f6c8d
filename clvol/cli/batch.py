"""clvol batch: renders all pictures of a job."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clvol.cli.devices import measure_for_all
from clvol.cli.options import complete_file, memory_cap_option
from clvol.cli.standard_output import is_standard
from clvol.cli.workers import check_workers, connection, workers_options
from clvol.errors import UsageError

if TYPE_CHECKING:
    from clvol.batch.job import Picture


@click.command("batch", short_help="Render many pictures: scenes x volumes x values of keys.")
@click.argument("job", metavar="JOB", shell_complete=complete_file)
@click.option("--device", "devices", multiple=True, metavar="NAME", help="As for 'clvol render'. Repeatable.")
@click.option("--isolate", is_flag=True, help="As for 'clvol render'.")
@workers_options("Render in N processes, which share the cores; one that crashes is replaced. By default in this one.")
@click.option(
    "--results", metavar="FILE", shell_complete=complete_file,
    help="Append a line of JSON per picture to FILE; by default JOB's name with .jsonl.",
)  # fmt: skip
@click.option(
    "--report", metavar="FILE", shell_complete=complete_file,
    help="Write a page (.html) of all pictures with their parameters, times, errors and failures at the end.",
)  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Print the names of the pictures, and render nothing.")
@memory_cap_option("Largest amount of memory that a volume may take, on the host and on the device.")
@click.option("--quiet", is_flag=True, help="Show no progress on the terminal.")
def command(
    job: str, devices: tuple[str, ...], isolate: bool, workers: int | None, scheduler: str | None,
    results: str | None, report: str | None, dry_run: bool, memory_cap: int | None, quiet: bool,
) -> None:  # fmt: skip
    """Render the pictures of JOB (.toml), and print a line of JSON for each.

    A job names scenes, volumes that take the place of theirs, keys that vary with their values, and a pattern of the
    pictures' names; every combination is a picture:

    \b
    scenes = ["scene.toml"]
    volumes = ["data/*.nrrd"]
    output = "out/{volume}_{camera.view}.png"
    [[vary]]
    key = "camera.view"
    values = ["front", "left"]

    A picture that fails is reported, and the others go on; the exit status is that of the worst failure. Pictures that
    exist, are whole and were made from the same scene, voxels and version are kept, so that a job that was interrupted
    goes on, and one that is finished does nothing. Several processes, also of several machines, may run a job in one
    folder: no picture is rendered twice, and those of a process that ends are taken over.
    """
    from clvol.batch.job import load_job, pictures_of

    loaded = load_job(job)
    pictures = pictures_of(loaded, job)
    _check_endings(pictures)
    if dry_run:
        from clvol.cli.console import say_path

        for picture in pictures:
            for path in picture.files:
                say_path(path)
        return
    from clvol.batch.report import write_report
    from clvol.batch.results import line_of
    from clvol.batch.run import JobRun, Options
    from clvol.batch.workers import WorkerPool
    from clvol.cli import say_error
    from clvol.cli.console import note, say, working
    from clvol.cluster.pictures import ClusterRun
    from clvol.inputs import Inputs, protected

    measure_for_all(devices, quiet)
    results = results or str(Path(job).with_suffix(".jsonl"))
    inputs = [job, *(each for p in pictures for each in (p.source, p.volume) if each is not None)]
    if scheduler is not None:
        check_workers(workers, scheduler)
    with protected(Inputs(list(dict.fromkeys(inputs)))), connection(None, scheduler, quiet) as cluster:
        _make_folders(pictures, results)
        if report is not None:
            _check_report(report)
        options = Options(list(devices) or None, memory_cap, isolate, loaded.max_error, results)
        with working(f"rendering {len(pictures)} pictures", quiet) as progress:

            def emit(result: dict[str, Any]) -> None:
                say(line_of(result))
                if result["status"] == "failed":
                    say_error(result["message"])

            run: JobRun | WorkerPool | ClusterRun = JobRun(pictures, options, emit, progress)
            if workers is not None:
                run = WorkerPool(job, pictures, options, workers, emit, progress)
            elif cluster is not None:
                run = ClusterRun(cluster, pictures, options, emit, progress)
            outcome = run.run()
            if report is not None:
                if progress is not None:
                    progress(None, None, "writing the report")
                write_report(report, Path(job).stem, pictures, results)
    if not quiet:
        counts = outcome.counts
        note(f"{counts['rendered']} rendered, {counts['kept']} kept, {counts['failed']} failed; see {results}")
    if outcome.status:
        raise click.exceptions.Exit(outcome.status)


def _check_endings(pictures: Sequence[Picture]) -> None:
    from clvol.image import ENDINGS

    for path in pictures[0].files:
        if Path(path).suffix.lower() not in ENDINGS:
            raise UsageError(path, f"unknown ending {Path(path).suffix!r}", " or ".join(ENDINGS))


def _check_report(report: str) -> None:
    from clvol.image import check_output_folder

    if Path(report).suffix.lower() not in (".html", ".htm"):
        raise UsageError("--report", f"got {report!r}", "a file name that ends in .html")
    check_output_folder(report)


def _make_folders(pictures: Sequence[Picture], results: str) -> None:
    """Makes the folders of the pictures, and checks that results can be written."""
    from clvol.image import check_output_folder

    if is_standard(results):
        what = f"got {results!r}, where the lines are printed already"
        raise UsageError("--results", what, "a file, which tells a later run what has been done")
    check_output_folder(results)
    for folder in dict.fromkeys(os.path.dirname(path) for p in pictures for path in p.files):
        try:
            os.makedirs(folder or ".", exist_ok=True)
        except OSError as error:
            raise UsageError(folder, f"the folder cannot be made: {error.strerror}", "a folder for pictures") from None

"""What every import does with its result: write the folder with its report, and print what became of each element."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from dcgrid_env.apps.importers.import_page import HTML_FILE, write_report
from dcgrid_env.apps.importers.import_record import ImportRecord, findings_table
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console, say


@dataclass(frozen=True)
class ImportOutput:
    """Folder of an import, and the kinds of loss that are allowed.

    Parameters
    ----------
    folder
        New or empty folder.
    allow
        Words of ``--allow``, separated by commas.
    """

    folder: Path
    allow: str

    def check(self) -> None:
        """Raise ValueError for a folder that has files."""
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            raise ValueError(f"out: must be a new or empty folder, got {self.folder}; choose another --out")
        check_folder(self.folder)

    @property
    def kinds(self) -> list[str]:
        """Kinds of elements that may be lost."""
        from dcgrid_env.grid.formats.import_stamp import UNVERIFIED

        return [kind for kind in split_names(self.allow) if kind != UNVERIFIED]

    def write(self, record: ImportRecord, tables: Callable[[Path], None]) -> None:
        """Write the tables and the report, and print the record.

        Raises
        ------
        ValueError
            After everything is written, if the import is not verified and this is not allowed.
        """
        from dcgrid_env.core.files import whole_folder
        from dcgrid_env.grid.formats.import_stamp import UNVERIFIED, write_stamp

        accepted, verdict = UNVERIFIED in split_names(self.allow), record.unverified
        with whole_folder(self.folder) as folder:
            tables(folder)
            if verdict:
                write_stamp(folder, verdict, accepted)
            write_report(record, folder)
        console = plain_console()
        console.print(findings_table(record.findings))
        for line in record.lines:
            say(console, line)
        say(console, f"wrote {self.folder}: {record.size}; {HTML_FILE} has the report")
        if verdict and not accepted:
            raise ValueError(
                f"{self.folder} is not verified: {verdict}; other commands refuse it; --allow {UNVERIFIED} accepts it"
            )

"""The text of a package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from nmpc_codegen.package.description import PackageDescription


@dataclass(frozen=True, eq=False)
class Sources(Mapping[str, str]):
    """Path -> text of every file of a package, which ``description`` describes."""

    files: Mapping[str, str] = field(repr=False)
    description: PackageDescription

    def __getitem__(self, path: str) -> str:
        return self.files[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)

    @property
    def foreign(self) -> tuple[str, ...]:
        """Folders of the code of other generators."""
        return folders_of(self.files)


def folders_of(paths: Iterable[str]) -> tuple[str, ...]:
    """The folders in which files of a package lie."""
    return tuple(sorted({path.split("/")[0] for path in paths if "/" in path}))

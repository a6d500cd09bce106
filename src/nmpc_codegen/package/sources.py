"""Sources is the text of a package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from nmpc_codegen.package.description import PackageDescription


@dataclass(frozen=True, eq=False)
class Sources(Mapping[str, str]):
    """An immutable mapping from the path to the text of every file of a package, which ``description`` describes."""

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
        """Return the folders of the code of other generators."""
        return folders_of(self.files)


def folders_of(paths: Iterable[str]) -> tuple[str, ...]:
    """Return the folders that contain files of a package."""
    return tuple(sorted({path.split("/")[0] for path in paths if "/" in path}))

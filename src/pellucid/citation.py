"""The package and the papers whose methods it implements, ready to be cited."""

from __future__ import annotations

from dataclasses import dataclass

from .version import __version__

AUTHORS = "The pellucid developers"
TITLE = "pellucid: fast rendering of translucent materials for Mitsuba 3"


@dataclass(frozen=True)
class Paper:
    """One publication, and what of it is used here."""

    key: str
    authors: tuple[str, ...]
    """As ``First Last``."""
    title: str
    journal: str
    """The abbreviated name of the journal or conference."""
    year: int
    pages: str
    used_for: str
    doi: str = ""
    volume: str = ""
    number: str = ""

    def line(self) -> str:
        """Write the paper as one line of a list of references."""
        *most, last = self.authors
        who = f"{', '.join(most)} and {last}"
        doi = f" doi:{self.doi}" if self.doi else ""
        issue = f" {self.volume}({self.number})" if self.volume else ""
        return f"{who}: {self.title}. {self.journal}{issue}, {self.year}, pp. {self.pages}.{doi}"

    def bibtex(self) -> str:
        """Write the paper as an entry of a BibTeX file."""
        kind, where = ("article", "journal") if self.volume else ("inproceedings", "booktitle")
        fields = {
            "author": " and ".join(self.authors),
            "title": f"{{{self.title}}}",
            where: self.journal,
            "volume": self.volume,
            "number": self.number,
            "year": str(self.year),
            "pages": self.pages.replace("-", "--"),
            "doi": self.doi,
        }
        return _entry(kind, self.key, fields)


def software_line() -> str:
    """Write the package as one line of a list of references."""
    return f"{AUTHORS}: {TITLE}. Version {__version__}."


def software_bibtex() -> str:
    """Write the package as an entry of a BibTeX file."""
    fields = {"author": f"{{{AUTHORS}}}", "title": f"{{{TITLE}}}", "note": f"Version {__version__}"}
    return _entry("misc", "pellucid", fields)


def _entry(kind: str, key: str, fields: dict[str, str]) -> str:
    """Write an entry of a BibTeX file, empty fields left out."""
    body = ",\n".join(f"  {name:<9} = {{{value}}}" for name, value in fields.items() if value)
    return f"@{kind}{{{key},\n{body}\n}}"


PAPERS = (
    Paper(
        key="JB02",
        authors=("Henrik Wann Jensen", "Juan Buhler"),
        title="A Rapid Hierarchical Rendering Technique for Translucent Materials",
        journal="ACM Transactions on Graphics",
        volume="21",
        number="3",
        year=2002,
        pages="576-581",
        doi="10.1145/566654.566619",
        used_for="pellucid_two_pass, pellucid_exact",
    ),
    Paper(
        key="CLHHC08",
        authors=("Chih-Wen Chang", "Wen-Chieh Lin", "Tan-Chi Ho", "Tsung-Shian Huang", "Jung-Hong Chuang"),
        title="Real-Time Translucent Rendering Using GPU-based Texture Space Importance Sampling",
        journal="Computer Graphics Forum",
        volume="27",
        number="2",
        year=2008,
        pages="517-526",
        doi="10.1111/j.1467-8659.2008.01149.x",
        used_for="pellucid_texture_space, the viewer",
    ),
    Paper(
        key="AWB08",
        authors=("Adam Arbree", "Bruce Walter", "Kavita Bala"),
        title="Single-pass Scalable Subsurface Rendering with Lightcuts",
        journal="Computer Graphics Forum",
        volume="27",
        number="2",
        year=2008,
        pages="507-516",
        doi="10.1111/j.1467-8659.2008.01148.x",
        used_for="pellucid_single_pass",
    ),
    Paper(
        key="JMLH01",
        authors=("Henrik Wann Jensen", "Stephen R. Marschner", "Marc Levoy", "Pat Hanrahan"),
        title="A Practical Model for Subsurface Light Transport",
        journal="SIGGRAPH '01: Proceedings",
        year=2001,
        pages="511-518",
        doi="10.1145/383259.383319",
        used_for="pellucid_sampled, the dipole, the measured materials",
    ),
    Paper(
        key="NGDRNJ06",
        authors=(
            "Srinivasa G. Narasimhan",
            "Mohit Gupta",
            "Craig Donner",
            "Ravi Ramamoorthi",
            "Shree K. Nayar",
            "Henrik Wann Jensen",
        ),
        title="Acquiring Scattering Properties of Participating Media by Dilution",
        journal="ACM Transactions on Graphics",
        volume="25",
        number="3",
        year=2006,
        pages="1003-1012",
        doi="10.1145/1141911.1141986",
        used_for="the measured liquids",
    ),
    Paper(
        key="WFABDG05",
        authors=(
            "Bruce Walter",
            "Sebastian Fernandez",
            "Adam Arbree",
            "Kavita Bala",
            "Michael Donikian",
            "Donald P. Greenberg",
        ),
        title="Lightcuts: A Scalable Approach to Illumination",
        journal="ACM Transactions on Graphics",
        volume="24",
        number="3",
        year=2005,
        pages="1098-1107",
        doi="10.1145/1073204.1073318",
        used_for="the light trees and cuts of pellucid_single_pass",
    ),
    Paper(
        key="WABG06",
        authors=("Bruce Walter", "Adam Arbree", "Kavita Bala", "Donald P. Greenberg"),
        title="Multidimensional Lightcuts",
        journal="ACM Transactions on Graphics",
        volume="25",
        number="3",
        year=2006,
        pages="1081-1088",
        doi="10.1145/1141911.1141997",
        used_for="the bounds and representatives of pellucid_single_pass",
    ),
    Paper(
        key="DS03",
        authors=("Carsten Dachsbacher", "Marc Stamminger"),
        title="Translucent Shadow Maps",
        journal="Eurographics Workshop on Rendering",
        year=2003,
        pages="197-201",
        doi="10.2312/EGWR/EGWR03/197-201",
        used_for="the local part of the hybrid method",
    ),
    Paper(
        key="MKBVR03",
        authors=("Tom Mertens", "Jan Kautz", "Philippe Bekaert", "Frank Van Reeth", "Hans-Peter Seidel"),
        title="Efficient Rendering of Local Subsurface Scattering",
        journal="Pacific Graphics '03: Proceedings",
        year=2003,
        pages="51-58",
        used_for="the image-space baseline of the engine, the filter of the hybrid method",
    ),
)
"""The papers of the three methods, the one that all of them build on, and those from which parts of them come."""

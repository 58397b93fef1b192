"""The papers whose methods the package implements, ready to be cited."""

from __future__ import annotations

from dataclasses import dataclass


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
    doi: str
    used_for: str
    volume: str = ""
    number: str = ""

    def line(self) -> str:
        """Write the paper as one line of a list of references."""
        *most, last = self.authors
        who = f"{', '.join(most)} and {last}"
        issue = f" {self.volume}({self.number})" if self.volume else ""
        return f"{who}: {self.title}. {self.journal}{issue}, {self.year}, pp. {self.pages}. doi:{self.doi}"

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
        body = ",\n".join(f"  {name:<9} = {{{value}}}" for name, value in fields.items() if value)
        return f"@{kind}{{{self.key},\n{body}\n}}"


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
        used_for="the single-pass method",
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
)
"""The three papers, and the one that all of them build on."""

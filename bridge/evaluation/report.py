"""report.html: what an evaluation found, in one file that needs neither the paper nor the code to be understood.

The page is a template (bridge/pages/templates); here are the figures, and what of the scenes is shown.
"""

from pathlib import Path
from typing import Any

from bridge.evaluation.totals import Evaluation
from bridge.files import write_text
from bridge.pages.charts import distribution_figure, diversity_figure
from bridge.pages.parts import Section, macro, number, page
from bridge.pictures import figures
from hid2.evaluation.realism import FEATURES, GENERATED
from hid2.reasons import Reason

#: The paper's Table 1, Argoverse 2.
PAPER_ORIGINAL = {"lo": 1.648, "la": 0.476, "je": 8.106, "scr": 0.072, "orr": 0.142}
PAPER_HID2 = {"lo": 1.465, "la": 0.486, "je": 7.801, "scr": 0.051, "orr": 0.114}

_TITLES = {
    "glance": "At a glance: are the generated vehicles safe?",
    "encounters": "Encounters",
    "realism": "Realism",
    "events": "Events asked for",
    "safety": "Safety",
    "motion": "Motion",
    "diversity": "Diversity",
    "requests": "Asked for and delivered",
    "words": "Words",
}


def write_report(evaluation: Evaluation, path: Path) -> None:
    """Write the report of an evaluation. Errors: OSError."""
    figures.style()
    metrics, totals = evaluation.metrics, evaluation.totals
    shown: dict[str, Any] = {
        "diversity": figures.data_uri(diversity_figure(metrics["diversity"])),
        "distributions": totals.realism.of(FEATURES[0])[GENERATED].sum()
        and figures.data_uri(distribution_figure(totals.realism)),
        "events": totals.events,
        "features": {feature.name: feature for feature in FEATURES},
        "paper": {key: (number(PAPER_ORIGINAL[key]), number(PAPER_HID2[key])) for key in PAPER_ORIGINAL},
    }
    sections: list[Section] = []
    for key, title in _TITLES.items():
        # the reasons that the sections above lead to
        shown["reasons"] = [one for one in Reason if any(f'"#reason-{one}"' in section.body for section in sections)]
        sections.append(Section(key, title, macro("report.html.j2", key, metrics, shown)))
    intro = macro("report.html.j2", "intro", metrics["scenes"])
    write_text(path, page("Generated traffic scenes: evaluation", [intro], [s for s in sections if s.body]))

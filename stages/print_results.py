"""Print where the results are and how to open them; the last step of `make run`.

Examples:

    python -m stages.print_results
"""

from pathlib import Path

REPORTS = Path("data/reports")
INDEX = Path("data/index.html")


def main() -> None:
    """Print the paths of the main report, of the simulated one, and of the recordings."""
    published, simulated = REPORTS / "published" / "report.html", REPORTS / "damped" / "report.html"
    if not published.exists():
        print("data/raw holds no published jumps: this is the report of simulated hardware.")
    report = published if published.exists() else simulated
    print(f"report: {report}\n  open it:    xdg-open {report}")
    if report is published:
        print(f"  simulated:  {simulated}")
    print("  recordings: rerun data/views/*.rrd" + (" data/views_published/*.rrd" if report is published else ""))
    for page in (INDEX, INDEX.with_name("published.html")):
        if page.exists():
            print(f"  all results: {page}")


if __name__ == "__main__":
    main()

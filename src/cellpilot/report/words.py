"""The summary of a run in words, put together from its numbers."""

from typing import Any

from cellpilot.experiment import divergence_warning, threshold_warning
from cellpilot.report.numbers import EXACT_TO, count, number, percent
from cellpilot.report.style import policy_line
from cellpilot.runs.content import Content
from cellpilot.text import as_flags


def summary_paragraphs(run: Content) -> list[str]:
    """The summary: the place with baseline and optimum, then each learned policy against them, then warnings."""
    rows: dict[str, dict[str, Any]] = run.metrics["policies"]
    greedy, optimal = rows.get("greedy"), rows.get("optimal")
    place = [_map_sentence(run)]
    if greedy is not None:
        place.append(
            f"The greedy baseline, which flies a shortest path without regard to the radio, makes "
            f"{percent(greedy['low_sinr_share'])} of its steps below the threshold."
        )
    if optimal is not None:
        place.append(_policy_sentence("The exact optimum", optimal, greedy) + ".")
    learned = [_learned_sentences(name, row, greedy, run) for name, row in rows.items() if name.startswith("learned/")]
    if not learned:
        learned = ["The run has no learned policy: figures of actions and values show the optimum."]
    return [" ".join(place), *learned, *_warnings(run)]


def _map_sentence(run: Content) -> str:
    world, threshold_db = run.world, run.task.threshold_db
    share = float((world.signal.mean_db[world.airspace.free_cells] < threshold_db).mean())
    sides = " x ".join(str(n) for n in world.grid.sides[: world.grid.n_dimensions])
    noise = f"noise of {world.signal.noise_std_db:g} dB in every step" if world.signal.noise_std_db else "no noise"
    return (
        f"{sides} cells, {noise}: the mean SINR lies below the threshold of {threshold_db:g} dB in {percent(share, 1)} "
        "of the free cells."
    )


def _learned_sentences(name: str, row: dict[str, Any], greedy: dict[str, Any] | None, run: Content) -> str:
    boltzmann = "Boltzmann exploration at temperature"
    flown = policy_line(name).label.removeprefix("learned, ").replace("Boltzmann", boltzmann)
    who, failed = f"The learned policy, flown with {flown},", 1 - row["reached_share"]
    if failed < EXACT_TO:
        return f"{_policy_sentence(who, row, greedy)}; {_score_words(row)}. It reaches the goal in every flight."
    how = "arg max repeats the same moves until" if name == "learned/argmax" else "they are still under way at"
    # Whoever fails circles in good cells, so failure is named before the share of bad steps can impress.
    return (
        f"{who} fails to reach the goal in {percent(failed)} of the flights: {how} the cap of {run.task.max_steps} steps. "
        f"{_policy_sentence('It', row, greedy)}; {_score_words(row)}."
    )


def _policy_sentence(who: str, row: dict[str, Any], greedy: dict[str, Any] | None) -> str:
    low = row["low_sinr_share"]
    text = f"{who} makes {percent(low)} of its steps below the threshold"
    if greedy is not None and greedy["low_sinr_share"] > 0:
        change = 1 - low / greedy["low_sinr_share"]
        text += f", {percent(abs(change), 0)} {'less' if change >= 0 else 'more'} than the baseline"
    if row["path_ratio_p90"] is not None:
        of_those = "" if row["reached_share"] == 1 else " of those that reach the goal"
        text += f", with a path at most {number(row['path_ratio_p90'])} times the shortest in nine of ten flights{of_those}"
    return text


def _score_words(row: dict[str, Any]) -> str:
    score = row.get("score")
    if score is None:
        return "baseline and optimum earn the same return, so there is nothing to score"
    if score < 0:
        return f"its return is worse than that of the baseline (score {number(score, 3)})"
    return f"it earns {percent(score, 1)} of the return that the optimum gains over the baseline (score {number(score, 3)})"


def _warnings(run: Content) -> list[str]:
    warnings = []
    if warning := threshold_warning(run.world, run.task.threshold_db):
        warnings.append(f"Warning: {warning}.")
    if run.parameters is not None and (warning := divergence_warning(run.parameters, run.world, run.task)):
        warnings.append(f"Warning: {as_flags(warning)}.")
    unreachable = run.metrics.get("unreachable_pairs", 0)
    if unreachable:
        warnings.append(f"{count(unreachable)} start-goal pairs are cut apart by blocked cells and left out.")
    return warnings

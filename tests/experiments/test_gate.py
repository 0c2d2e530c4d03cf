from experiments.gate import verdict


def row(model: str, error: float, loss: float, minus: dict, *, seed: int | None = None, lookup: str | None = "map"):
    return {
        "model": model,
        "seed": seed,
        "start": "causal",
        "lookup": lookup,
        "horizon_s": 5.0,
        "distance_error_m": {"mean": error, "ci95": [error - 0.1, error + 0.1]},
        "loss": {"mean": loss, "ci95": [loss, loss]},
        "minus": minus,
    }


def test_the_verdict_compares_over_all_seeds_where_predictions_go():
    against_b = {
        "distance_error_m": {"mean": -2.0, "ci95": [-3.0, -1.0]},
        "loss": {"mean": -0.5, "ci95": [-0.6, -0.4]},
    }
    said = verdict(
        {
            "results": [
                row("df", 2.0, 0.5, {}, lookup="recorded"),
                row("df", 2.0, 0.5, {"b": against_b}),
                row("df", 9.0, 9.0, {}, seed=0),
                row("b", 4.0, 1.0, {}),
                row("kinematic", 8.0, 5.0, {}, lookup=None),
            ]
        }
    )
    lines = {line.split()[0]: line for line in said.splitlines()}
    assert "-50 % [-75, -25]" in lines["b"]
    assert "-50 % [-60, -40]" in lines["b"]
    assert lines["df"].split()[1] == "2.00"
    assert "%" not in lines["kinematic"]

"""Plans that change gear: which schedules are sampled, and that the way back is found where there is none ahead."""

import pytest
import torch

from offpiste.dynamics.base import rollout
from offpiste.errors import PlanningError
from offpiste.planning.gear_changes import GearSettings, improve_with_gears, schedules, with_pedal_and_gear
from offpiste.planning.mppi import Settings
from offpiste.planning.pedal import PEDAL_AND_WHEEL
from offpiste.planning.rollouts import situation_terrain, spread_model_state
from planning.test_kernel import GEARED, model, start
from planning_maps import situation

STEPS = 60
SETTINGS = Settings(PEDAL_AND_WHEEL, (0.3, 0.1), samples=60, iterations=2, rest=(0.5, 0.0))


def test_schedules_hold_the_gear_or_change_it_once():
    found = schedules(1.0, 6, GearSettings(moments=(0, 2, 9)))
    assert found.tolist() == [[1.0] * 6, [-1.0] * 6, [1.0, 1.0, -1.0, -1.0, -1.0, -1.0], [1.0] * 6]
    assert schedules(-1.0, 3, GearSettings(moments=(1,)))[1].tolist() == [-1.0, 1.0, 1.0]
    assert schedules(0.0, 3, GearSettings(moments=(1,)))[1].tolist() == [0.0, 1.0, 1.0]


def parametric_cost(wanted):
    """Of being far from a place along x at the end, on level ground; keeps what it was given."""
    at, dynamics = situation(state=(0.0, 0, 0, 0, 0, 0)), model("parametric", GEARED)
    seen = []

    def cost_of(controls):
        seen.append(controls)
        source = situation_terrain(dynamics, at, len(controls))
        rolled = rollout(dynamics, spread_model_state(start(dynamics, at), len(controls)), controls, source)
        return (rolled.state[:, -1, 0] - wanted).square()

    return with_pedal_and_gear(cost_of), seen


@pytest.mark.parametrize(("wanted", "gear"), [(2.0, 1.0), (-2.0, -1.0)])
def test_it_drives_forward_to_what_is_ahead_and_backs_out_to_what_is_behind(wanted, gear):
    cost_of, seen = parametric_cost(wanted)
    last = []
    for seed in range(9):
        seen.clear()
        found = improve_with_gears(torch.zeros(STEPS, 2), 1.0, cost_of, SETTINGS, torch.Generator().manual_seed(seed))
        last.append(float(found.gear[-1]))
        assert float(cost_of(found.plan.controls[None], found.gear)[0]) < 0.5 * wanted**2
    assert last.count(gear) > len(last) / 2, "some of so few samples coast forward in the other gear"
    sampled = [controls for controls in seen if len(controls) > 1]
    assert sum(map(len, sampled)) == SETTINGS.iterations * SETTINGS.samples, "as many as without changes"
    assert {tuple(controls[0, [0, -1], 3].tolist()) for controls in sampled} == {(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)}


def test_a_plan_that_holds_its_gear_continues_the_last_one():
    begun = []

    def cost_of(controls, gear):
        begun.append((controls[0], float(gear[-1])))
        return controls.square().sum(dim=(1, 2))

    last = torch.full((STEPS, 2), 0.25)
    improve_with_gears(last, 1.0, cost_of, SETTINGS, torch.Generator().manual_seed(0))
    assert torch.equal(begun[0][0], last)
    reverse = next(controls for controls, gear in begun if gear < 0)
    assert torch.equal(reverse, torch.tensor([0.5, 0.0]).expand(STEPS, 2))


def test_where_no_schedule_has_a_finite_cost_that_is_said():
    def cost_of(controls, gear):
        return torch.full((len(controls),), torch.nan)

    with pytest.raises(PlanningError, match="finite cost"):
        improve_with_gears(torch.zeros(STEPS, 2), 1.0, cost_of, SETTINGS, torch.Generator().manual_seed(0))


@pytest.mark.parametrize("given", [{"share": 0.0}, {"share": 1.0}, {"moments": ()}, {"moments": (-1,)}])
def test_settings_that_sample_nothing_are_refused(given):
    with pytest.raises(PlanningError, match="give a share between 0 and 1"):
        GearSettings(**given)

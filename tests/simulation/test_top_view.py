from io import BytesIO

from matplotlib.figure import Figure

from offpiste.simulation.top_view import draw_top_view, shaded_colours
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings


def test_a_world_is_drawn():
    world = make_world(WorldSettings(preset="halter-ranch", size=80.0, resolution=1.0))
    colours = shaded_colours(world)
    assert colours.min() >= 0
    assert colours.max() <= 1
    assert colours.std(axis=(0, 1)).min() > 0.02
    figure = Figure()
    draw_top_view(world, figure.subplots())
    figure.savefig(BytesIO(), format="png", dpi=40)
    assert figure.axes[0].get_xlim() == (-40, 40)

from io import BytesIO

import numpy as np
from matplotlib.figure import Figure

from offpiste.simulation.top_view import draw_top_view, shaded_colours
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings


def test_a_world_and_a_drive_are_drawn():
    world = make_world(WorldSettings(preset="halter-ranch", size=80.0, resolution=1.0))
    colours = shaded_colours(world)
    assert colours.min() >= 0
    assert colours.max() <= 1
    assert colours.std(axis=(0, 1)).min() > 0.02
    path = world.trails[0]
    figure = Figure()
    draw_top_view(world, figure.subplots(), path, speed=np.linspace(0, 10, len(path)))
    figure.savefig(BytesIO(), format="png", dpi=40)
    axes = figure.axes[0]
    assert axes.get_xlim() == (-40, 40)
    assert len(figure.axes) == 2  # and the scale of speeds

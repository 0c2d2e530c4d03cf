"""A column of the windows from outside the package: the temperature of the air.

Rigs may then have an entry [channels.temperature]; datasets store the column, and batches hold it for the history and
the start of each window. Name this module in the environment to use it:

    PYTHONPATH=examples/extending OFFPISTE_EXTENSIONS=temperature offpiste extract drive.csv --rig rig.toml
"""

from offpiste.dataset.columns import COLUMNS, channel_column
from offpiste.rig.channels import declare_channel

declare_channel("temperature", unit="degC")
COLUMNS.register("temperature")(channel_column("temperature", "past", "start"))

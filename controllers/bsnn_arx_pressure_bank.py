"""The cascade with measured pressures and a bank of faults: names what broke, then learns."""

from leglab.control import register_controller
from leglab.controllers.bsnn_arx_bank import BankConfiguration, BankController
from leglab.controllers.bsnn_arx_pressure import PressureConfiguration, PressureController


class PressureBankConfiguration(BankConfiguration, PressureConfiguration):
    """Settings of `bsnn_arx_bank` and of `bsnn_arx_pressure`."""


@register_controller(
    "bsnn_arx_pressure_bank",
    summary="is bsnn_arx_pressure that names what broke, corrects its map at once, and learns the "
    "rest",
    configuration=PressureBankConfiguration,
)
class PressureBankController(BankController, PressureController):
    """As `bsnn_arx_bank`, on the maps of `bsnn_arx_pressure`."""

    name = "bsnn_arx_pressure_bank"
    learns_as = "bsnn_arx_pressure"

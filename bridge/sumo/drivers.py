"""What a driver is to SUMO: attributes of vehicle types, for the simulation and for files that SUMO reads."""

from hid2.drivers.driver import Driver
from hid2.params import Config

#: SUMO's emergencyDecel of cars, m/s2.
_EMERGENCY_MPS2 = 9.0


def model_parameters(config: Config) -> dict[str, float]:
    """Attributes of the vehicle type that all vehicles of a configuration share, beside the car-following model."""
    found: dict[str, float] = {}
    if config.car_following.model == "EIDM":
        found = {"sigmaerror": config.drivers.error, "treaction": config.drivers.reaction_s}
    if config.lane_change.rule == "LC2013":
        found |= {"lcSpeedGain": config.lane_change.lc_speed_gain}
    return found


def driver_attributes(driver: Driver, model: str) -> dict[str, float]:
    """Attributes of a type of one driver's own: a driver desires its own speed, whatever the lane allows beyond it."""
    return {
        "accel": driver.accel_mps2, "decel": driver.decel_mps2,
        "emergencyDecel": max(driver.decel_mps2, _EMERGENCY_MPS2), "tau": driver.tau_s, "minGap": driver.min_gap_m,
        "maxSpeed": driver.desired_mps, "speedFactor": 1.0, "speedDev": 0.0,
    } | ({"sigma": 0.0} if model == "Krauss" else {})  # fmt: skip

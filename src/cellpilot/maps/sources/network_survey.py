"""CSV logs of the Android program Network Survey, LTE and NR.

Position of GPS with altitude, accuracy and age; `#` comment lines.
"""

from dataclasses import replace

from cellpilot.maps.samples import ELLIPSOID
from cellpilot.maps.sources.log_format import LogFormat, rsrp, rsrq, sinr
from cellpilot.maps.text_table import Column

NETWORK_SURVEY_LTE = LogFormat(
    name="Network Survey (LTE)",
    signature=("deviceTime", "latitude", "longitude", "altitude", "rsrp", "snr"),
    latitude="latitude",
    longitude="longitude",
    sinr=sinr("snr"),
    rsrp=rsrp("rsrp"),
    rsrq=rsrq("rsrq"),
    cell="eci",
    time="deviceTime",
    altitude=Column("altitude", -500.0, 10_000.0, "m"),
    altitude_reference=ELLIPSOID,
    accuracy="accuracy",
    age="locationAge",
    serving="servingCell",
)
NETWORK_SURVEY_NR = replace(
    NETWORK_SURVEY_LTE,
    name="Network Survey (NR)",
    signature=("deviceTime", "latitude", "longitude", "altitude", "ssRsrp", "ssSinr"),
    sinr=sinr("ssSinr"),
    rsrp=rsrp("ssRsrp"),
    rsrq=rsrq("ssRsrq"),
    cell="nci",
)

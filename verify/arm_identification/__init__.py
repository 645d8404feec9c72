"""An arm's own parameters from measured poses: what the data support, how sure, what stays hidden.

    chain = chain_of(arm)
    found = identify(chain, poses)

`identify` works on plain arrays (readings, measured poses or positions, covariances), wherever they
come from; `session_poses` takes them from recorded sessions.
"""

from verify.arm_identification.chain import Chain, chain_of
from verify.arm_identification.identify import Identified, Wish, identify, register
from verify.arm_identification.poses import Poses

__all__ = ["Chain", "Identified", "Poses", "Wish", "chain_of", "identify", "register"]

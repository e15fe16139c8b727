"""Networks as prior providers for SGS: the protocol of docs/guide/priors.md, and one adapter a network.

The protocol, the stand-in and the one that misbehaves need nothing but the standard library. Each network's adapter
imports the network's own library, and only when it is asked for.
"""

__version__ = "0.1.0"

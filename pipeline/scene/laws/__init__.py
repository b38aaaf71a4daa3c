"""Laws that a scene names: of the rate, its coating and feedback, hardening, polarization, ions."""

"""The evaluation protocol: rules, controls and the expert's times."""

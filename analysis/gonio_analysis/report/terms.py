"""What names of columns and facts mean, in a line each: a page explains them wherever they head a column or a fact.

What stands here means the same on every page; what means something of one table alone is its own
`gonio_analysis.report.blocks.term`.
"""

MEANINGS = {
    # fits and models
    "reduced χ²": "Chi-square over its degrees of freedom: near 1 where model and stated uncertainties are right.",
    "value ± u": "The value and its standard uncertainty (k = 1).",
    "remarks": "What bounds the parameter, and which other one changes with it.",
    "typical difference": "The root mean square of ln(model / measured).",
    "rho_dh": "Directional-hemispherical reflectance: the share of the light from one direction that is reflected.",
    "tau_dh": "Directional-hemispherical transmittance: the share of the light from one direction that goes through.",
    "best model": "The one that is put first: the simplest that the data do not reject, or else the nearest.",
    # directions and values
    "θi": "Polar angle of the direction toward the source, from the surface's normal.",
    "θi/°": "Polar angle of the direction toward the source, from the surface's normal.",
    "φi/°": "Azimuth of the direction toward the source, from the sample's x axis.",
    "θr/°": "Polar angle of the direction toward the detector, from the surface's normal.",
    "φr/°": "Azimuth of the direction toward the detector, from the sample's x axis.",
    "BRDF f/sr⁻¹": "Bidirectional reflectance distribution function: reflected radiance over irradiance.",
    "π f": "The albedo of a Lambertian surface with this BRDF.",
    "incidences": "Polar angles of the direction toward the source.",
    "solid angles": "Of the cones in which light comes from the source and goes to the receiver, seen from the sample.",
    "values used": "Values that fits and figures use, of those in the table.",
    "beam on the sample": "How large the spot of light is beside the part of the sample that is averaged.",
    "white reference": "The surface of known BRDF that values are relative to.",
    # statistics
    "95th percentile": "95 of 100 values have a smaller one.",
    "quartiles": "One in four lies below the first, one in four above the second.",
    "rank correlation": "Spearman's: 1 where both put the materials into the same order.",
    "rms": "Root mean square.",
    "rms error": "Root mean square of the errors.",
    "rms residual": "Root mean square of measured less model.",
    "mean residual": "Mean of measured less model.",
    "χ² a value": "Chi-square over the number of values: near 1 where model and stated uncertainties are right.",
    "normalised error": "(found - true) / u: its standard deviation is 1 where uncertainties are right.",
    "typical u": "The median of the standard uncertainties.",
    "99 % of pixels": "Between these two lie all but the lowest and the highest 0.5 %.",
    "determined in": "Pixels whose values say what the parameter is.",
    "median B/A": "The middle one of the ratios B / A.",
    "beyond 2": "Values whose difference is more than two standard deviations.",
    "median z": "The middle one of the differences over their standard uncertainties.",
    # laboratories
    "scale": "The factor of a laboratory's values, over the directions that all have.",
    "d / %": "Degree of equivalence: how far the laboratory's scale is from the reference value.",
    "U(d) / %": "Expanded uncertainty (k = 2) of the degree of equivalence.",
    "E_n": "d over U(d): beyond 1 either way the laboratory is not consistent with the reference value.",
    "dark uncertainty": "What the laboratories differ by beyond what they state.",
    # checks and records
    "the limit": "Beyond it the check is not passed.",
    "plan's SHA-256": "A fingerprint of the plan: equal plans have equal ones.",
    "seed": "The number from which all random numbers of a simulation follow.",
    "steps": "Dark frames, measurements of the reference and points of the plan, together.",
    "reduced by": "The program and version that made BRDFs of the frames.",
}
"""Name -> what it means, for a reader of optics or statistics textbooks."""

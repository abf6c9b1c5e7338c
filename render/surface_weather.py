"""Constants of weather on surfaces: darkening of wet ground, slopes with snow, height of dust.

`render.blender.covers` builds nodes from them.

References
----------
Lagarde, "Water drop 3b: physically based wet surfaces", 2013.
"""

# Lagarde: a surface soaks up water if it is rougher than 0.5 (perceptual roughness), fully from 0.9 on.
POROUS_FROM, POROUS_AT = 0.5, 0.9
WET_DIFFUSE = 0.6  # of the dry albedo where fully porous; his 0.2 turns soil twice as dark as measured
WET_ROUGHNESS = 0.65  # of the dry roughness there
SNOW_ALBEDO = (0.80, 0.83, 0.86)
SNOW_LIES_TO, SNOW_SLIDES_FROM = 30.0, 60.0  # degrees of slope with all of the cover, and from which none is left
DUST_ALBEDO = (0.36, 0.28, 0.19)
DUST_FULL_TO, DUST_TO = 0.2, 1.2  # meters above a vehicle's underside
DUST_ON_TOPS = 0.35  # of what lies on the lower parts; on scenery too

"""The demo's vehicles, sceneries, and skies, built by script: ordinary .blend files and HDRIs, as users have them."""

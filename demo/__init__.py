"""The demo's own content, built by script: ordinary .blend files and HDRIs, as a user would bring them."""

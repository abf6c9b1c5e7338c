"""Demo assets modelled by code: ordinary .blend files and HDRIs, the same kind of files a user would bring."""

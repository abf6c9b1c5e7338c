"""Pictures for people: sheets of images, and displays in notebooks."""

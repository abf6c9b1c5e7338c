"""Pictures for people: labels drawn on images, sheets of images, charts, and displays in notebooks."""

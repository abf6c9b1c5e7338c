"""Pictures for people: labels drawn on images, sheets of images, and displays in notebooks."""

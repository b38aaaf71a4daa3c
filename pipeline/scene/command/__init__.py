"""What a person types: options, scene files and their template, read into a scene."""

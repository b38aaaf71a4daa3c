"""Dissolved species: their reactions, activities, minerals and transport through the liquid."""

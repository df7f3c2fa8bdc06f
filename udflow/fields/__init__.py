"""Fields that answer: where is the surface from here?"""

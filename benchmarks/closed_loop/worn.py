from world import World, Recipe
class Worn(World): pass

"""Switch-on anywhere: how soon the heading is known, by kinds of receivers."""

"""The live page in the browser: nodes of a scene, a thread that drapes, and the page's controls."""

// Ends of the layers of a deep opacity map, behind the first hair [m]; the last layer has no end.
const vec3 layer_ends = vec3(0.006, 0.018, 0.045);
const float last_layer = 0.1;

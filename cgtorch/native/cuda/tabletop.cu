/* Rollouts in the tabletop's models on a GPU. */
#include "tabletop/environment.h"
#define GAMMA gamma.machine
#define CLASSIFIER classifier.machine
#include "rollouts.h"

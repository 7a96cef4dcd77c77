/* Rollouts in the models of any domain on a GPU. */
#include "svm/kernel_environment.h"
#define GAMMA gamma
#define CLASSIFIER classifier
#include "rollouts.h"

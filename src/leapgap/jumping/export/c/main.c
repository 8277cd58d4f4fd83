/* Reads estimates from the standard input and writes commands to the standard output, as raw doubles. */
#include <stdio.h>
#include "jump_controller.h"

int main(void) {
    JumpEstimate measured;
    JumpCommand command;
    jump_reset();
    while (fread(&measured, sizeof measured, 1, stdin) == 1) {
        jump_tick(&measured, &command);
        fwrite(&command, sizeof command, 1, stdout);
    }
    return 0;
}

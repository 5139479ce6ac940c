"""The drawings behind the textures: one character a pixel, top row first, '.' transparent.

A drawing is (colours, rows). Full drawings have 16 rows of 16; smaller ones are drawn onto others at an offset. Agents
see the textures at 7x7 pixels, sampled at columns and rows 1 3 5 7 10 12 14 (items at 5x5: 1 4 8 11 14, digits at 4x4:
2 6 10 14), so what tells two of them apart lies on those.
"""

CLEAR = (0, 0, 0, 0)
SHADOW = (0, 0, 0, 96)

# ---- Creatures and other objects ----

PLAYER_COLOURS = {
    'h': (74, 44, 22), 'H': (100, 62, 32), 'f': (236, 186, 140), 'F': (206, 150, 106), 'k': (28, 22, 30),
    't': (28, 160, 172), 'T': (52, 192, 200), 's': (18, 122, 138), 'b': (112, 76, 56), 'B': (86, 56, 42),
    'o': (48, 34, 28), ',': SHADOW,
}

PLAYER_FRONT = (PLAYER_COLOURS, '''
    ................
    .....hhhhhh.....
    ....hHHHHHHh....
    ....fkffffkf....
    ....fkffffkf....
    .....ffffff.....
    ...tTTFFFFTts...
    ..tTTtttttttss..
    ..tTtttttttsss..
    ..fFtttttttsFf..
    ..ffttttttss,f..
    ....bbbbbbbb,...
    ....bbB.,bbB,,..
    ....bbB.,bbB,,..
    ....ooo.,ooo,,..
    ......,,,,,,,...''')

PLAYER_BACK = (PLAYER_COLOURS, '''
    ................
    ................
    ..f..........f..
    ..ff.hhhhhh.ff..
    ..tt.hHHHHh.ts..
    ..tTthHHHHhtts..
    ...tTthhhhttss..
    ....TTttttts....
    ....Tttttttss...
    ....Tttttttss...
    ....tttttttss...
    ....bbbbbbbB,...
    ....bbB.,bbB,,..
    ....bbB.,bbB,,..
    ....ooo.,ooo,,..
    ......,,,,,,,...''')

PLAYER_SIDE = (PLAYER_COLOURS, '''
    ................
    .....hhhhhhh....
    ....hHHHHHHhh...
    ....ffffHHHhh...
    ....fkfffHHhh...
    ....ffffffhh....
    .....FFtTtts....
    ...TTTTTTttss...
    ..ffTTTTtttss...
    ..ff.tttttsss...
    .....tttttsss...
    .....bbbbbbBB,..
    .....bbb.bbBB,,.
    ....bbb..,bbB,,.
    ...oooo..ooo,,,.
    ......,,,,,,,...''')

PLAYER_SLEEP = (dict(PLAYER_COLOURS, p=(226, 222, 208), P=(186, 180, 168), z=(250, 236, 120), w=(122, 84, 44)), '''
    .........zzzzzz.
    .........zzzzzz.
    ............zz..
    ...........zz...
    .........zzzzzz.
    .........zzzzzz.
    wwwwwwwwwwwwwwww
    wpppptTTTTTTTTsw
    wphhpTttttttttsw
    wphffpTtttttttsw
    wphffpTttttttssw
    wphhpTtttttttssw
    wpPPptTtttttsssw
    wppppttttttssssw
    wwwwwwwwwwwwwwww
    .,,,,,,,,,,,,,,,''')

LAMP_COLOURS = {'k': (96, 44, 8), 'o': (255, 160, 24), 'y': (255, 220, 48), 'w': (255, 250, 200)}
LAMP_TALL = (LAMP_COLOURS, '''
    .kk.
    kkkk
    oyyo
    yywy
    ywwy
    ywwy
    yyyy
    oyyo
    kkkk''')
LAMP_WIDE = (LAMP_COLOURS, '''
    kkkkkk
    oyyyyo
    yywwyy
    oyyyyo
    kkkkkk''')

ZOMBIE = ({
    'g': (84, 146, 104), 'G': (136, 196, 146), 'D': (48, 96, 72), 'd': (30, 66, 58), 'e': (16, 42, 38),
    'r': (226, 40, 30), 'k': (12, 30, 20), ',': SHADOW,
}, '''
    ................
    .....DgggGD.....
    ....DgGGGGgD....
    ....grrGGrrg....
    ....gGGGGGGg....
    ....DgkkkkgD....
    .GG..dddddd..GG.
    .GGeddddddddeGG.
    ..gDdddeedddDg..
    ...,edeedddde,..
    ....eddddedde,..
    ....eddedddde,..
    ....dddeeddd,...
    ....dde.,edd,,..
    ...GGgg..gGGD,..
    .....,,,,,,,,...''')

SKELETON_COLOURS = {
    'w': (222, 222, 214), 'W': (246, 246, 240), 'x': (16, 14, 16), 'b': (166, 166, 162), 'B': (120, 120, 120),
    'd': (62, 60, 64), 's': (140, 92, 40), 'S': (232, 226, 210), ',': SHADOW,
}
SKELETON_BODY_KEYS = 'bBd'
SKELETON = (SKELETON_COLOURS, '''
    .....wwwwww.....
    ....wWWWWWWw....
    ....WWWWWWWw....
    ....WxxWWxxw....
    ....wxxWWxxw.ss.
    .....wWxxWw...ss
    .....xwxxwx..S.s
    ..bbbbbbbbbbbS.s
    ..bddBbbBddBbbbs
    ..b.bbbbbbBd.S.s
    .bb.ddBbBdd..S.s
    ....bbbbbbBd,.ss
    ....bBd,.bBd,ss.
    ....bB,,.bBd,,..
    ...bbB,.bbBd,,..
    .....,,,,,,,,...''')

COW = ({
    'w': (238, 232, 220), 'W': (206, 196, 180), 'b': (126, 72, 36), 'B': (92, 50, 26), 'p': (232, 158, 150),
    'k': (24, 18, 16), 'h': (246, 236, 190), ',': SHADOW,
}, '''
    ................
    .........h....h.
    .........hbbbbh.
    .........bbbbbbb
    .wwwbbbbwbkbbbkb
    bwwbbbbbwbbwwbbb
    bwwbbbbwwwbpppp.
    bwwwbbwwwwbpppp.
    bwwwwwwwbbb.....
    .wwwwwwbbbbb,...
    .wbbbwwwbbbB,,..
    .WWbbwWWWbBB,,..
    .wW.,ww,,bB,bB..
    .wW.,wW,,bB,bB..
    .kk.,kk,,kk,kk..
    ..,,,,,,,,,,,...''')

ARROW_RIGHT = ({
    'k': (64, 68, 82), 'K': (112, 118, 134), 'b': (160, 110, 52), 'B': (122, 80, 36), 'w': (248, 248, 248),
    'W': (200, 200, 208),
}, '''
    ................
    ................
    ................
    ................
    ..........K.....
    ww........KK....
    .ww.......kKK...
    ..wwbbbbbbkkKKK.
    .WWWBBBBBBkkkKk.
    .WW.......kkk...
    WW........kk....
    ..........k.....
    ................
    ................
    ................
    ................''')

PLANT_COLOURS = {
    'g': (8, 66, 26), 'G': (18, 98, 38), 'L': (120, 206, 84), 's': (84, 50, 26), 'S': (112, 70, 38),
    'r': (226, 40, 60), 'R': (255, 120, 120), 'd': (150, 20, 44), ',': SHADOW,
}
PLANT = (PLANT_COLOURS, '''
    ................
    ..ggg..LL..ggg..
    .gGLLg.GG.gLLGg.
    gGLLGGgGGgGGLLGg
    gGGGGGGggGGGGGGg
    .gggGGGGGGGGggg.
    ...,ggGGGGgg,...
    .gggg,gGGg,gggg.
    gGLLGGgGGgGGLLGg
    gGGGGGGGGGGGGGGg
    .gggggGGGGggggg.
    ..sss,gGGg,ssss.
    .sSSSSsGGsSSSSss
    sSSSSSSSSSSSSSSs
    .ssSSSSSSSSSSss,
    ...ssssssssss,,.''')
FRUIT = (PLANT_COLOURS, '''
    .rr.
    rRRr
    rRrd
    .dd.''')
FRUIT_PLACES = ((2, 2), (10, 2), (6, 5), (1, 8), (11, 8))
PLANT_YOUNG = (PLANT_COLOURS, '''
    ................
    ................
    ................
    ................
    ................
    ....LL....LL....
    ...LGGL..LGGL...
    ...gGGGLLGGGg...
    ....ggGGGGgg....
    ......gGGg......
    .......GG.......
    ..sssssGGssssss.
    .sSSSSsGGsSSSSss
    .sSSSSSSSSSSSSSs
    ..sssssssssssss,
    ....,,,,,,,,,,..''')

FENCE = ({'p': (150, 106, 58), 'P': (184, 138, 82), 'd': (104, 70, 36), ',': SHADOW}, '''
    ................
    ..PPp......PPp..
    ..Ppd......Ppd..
    ..Ppd......Ppd..
    PPPPPPPPPPPPPPPP
    pppppppppppppppp
    ddPpdddddddPpddd
    ..Ppd......Ppd..
    ..Ppd......Ppd..
    PPPPPPPPPPPPPPPP
    pppppppppppppppp
    ddPpdddddddPpddd
    ..Ppd......Ppd..
    ..Ppd......Ppd..
    ..ppd,,....ppd,,
    ...,,,......,,,.''')

# ---- Small stamps that make materials out of noise ----

TUFT = ({'g': (34, 122, 38), 'L': (84, 184, 70)}, '''
    L.L
    gLg
    .g.''')
WAVE = ({'w': (128, 184, 248), 'b': (84, 150, 238)}, '''
    .www..
    w...wb''')
PEBBLE_OF_SAND = ({'d': (190, 168, 104), 'w': (250, 240, 200)}, '''
    wd''')
PEBBLE_OF_PATH = ({'a': (160, 142, 112), 'b': (140, 122, 94), 'd': (84, 66, 44)}, '''
    aab
    bbd''')
CRACK = ({'d': (82, 82, 84), 'L': (156, 156, 158)}, '''
    d....
    Ldd..
    .Ldd.
    ..L..''')

# ---- Objects: drawn over grass or stone ----

TREE_COLOURS = {
    'd': (10, 58, 18), 'g': (16, 82, 26), 'G': (28, 108, 36), 'L': (52, 136, 48), 't': (112, 72, 36),
    'T': (142, 96, 52), 'k': (72, 44, 22), ',': SHADOW,
}
TREE_CROWN_KEYS = 'dgGL'
TREE = (TREE_COLOURS, '''
    .....dddddd.....
    ...ddgGGGgddd...
    ..dgGLLGGGGggd..
    .dgGLLLGGgGGggd.
    .dGLLLGGGGGLGgd.
    dgGLGGGgGGLLGGgd
    dgGGGGGGGGLGGggd
    dgGGgGLLGGGGGggd
    dggGGGLGGGgGGgdd
    .dgGGGGGGGGGggd.
    .ddggGGgGGgggdd.
    ..dddgdktTdddd,,
    ...,ddktTtkd,,,,
    ....,,ktTtk,,,,.
    .....ktTTttk,,..
    ....kttk.kttk...''')

COAL_COLOURS = {'k': (16, 16, 20), 'K': (42, 42, 48), 'L': (84, 86, 94), 'd': (70, 70, 72)}
COAL_LUMP_KEYS = 'kKL'
COAL = (COAL_COLOURS, '''
    ..kkkk..........
    .kKLLKk....kkk..
    .kKLKKkd..kKLKk.
    .kKKKkkd..kLKKkd
    .kkKkkkd..kKKkkd
    ..kkkkd...kkkkd.
    ...ddd.kkk.ddd..
    ......kKLKkk....
    .kkk.kKLLKKkk...
    kKLKkkKLKKkkk.k.
    kLKKkdkKKKkkdkKk
    kKKkkdkkkkkkdkLk
    kkkkd..kkkkd.kkk
    .kkd...dddd..kkd
    ................
    ................''')

IRON = ({'o': (214, 140, 84), 'O': (240, 196, 150), 'd': (150, 88, 52), 'k': (84, 80, 78)}, '''
    ................
    .oOO.....oo.....
    .oOoo...oOOo....
    .dooo...oOood...
    ..dd.k..dooodk..
    ....oOo..dddk.oo
    ...oOOoo.....oOO
    ...ooooo....doOo
    ...dooood....ddo
    ....dddk.oo...kd
    .oo.....oOOo....
    oOOo....ooOod...
    ooood...dooodkoo
    dooodk...dddkoOO
    .dddk.......kdoo
    ..............dd''')

DIAMOND = ({
    'w': (250, 254, 255), 'c': (150, 236, 250), 'C': (92, 208, 236), 'd': (44, 140, 176), 'k': (78, 78, 84),
}, '''
    ................
    ....ww..........
    ...wwcc....w....
    ..wwwcCC..wcC...
    .wwwccCCCwwcCC..
    ..wwccCCdwccCCd.
    ...wccCdkkcCCdk.
    ....cCdk...Cdk..
    .....dk..w..k...
    .......wwcC.....
    ..w...wwwcCC....
    .wcC.wwwccCCC...
    wwcCCkwwccCCd...
    .wcCdk.wccCdk...
    ..Cdk...cCdk....
    ...k.....dk.....''')

TABLE = ({
    'd': (74, 46, 22), 'a': (168, 122, 66), 'A': (190, 144, 84), 'b': (148, 104, 54), 's': (112, 76, 38),
    'm': (150, 154, 160), 'M': (206, 210, 214), 'n': (88, 92, 98), 'h': (96, 40, 28), 'H': (136, 60, 38),
}, '''
    dddddddddddddddd
    dAAAAAAAaaaAAAAd
    dAaannnnaaaaaaad
    daanMMMmnaaabaad
    dssnMmmmnnsssssd
    dAAnmmmnHnAAAAad
    dAaannnHHHaaaaad
    daaaaaanHHHaabad
    daabaaaaaHHHaaad
    dsssssssssHHHssd
    dAAAaaaAAAAhHHAd
    dAaaaabaaaaahhad
    daaaaaaaaaaaaaad
    dssssssssssssssd
    dbdbbbbbbbbbbdbd
    dddddddddddddddd''')

FURNACE = ({
    'd': (50, 50, 54), 'a': (108, 108, 112), 'A': (134, 134, 138), 'b': (82, 82, 88), 'k': (18, 14, 16),
    'r': (206, 54, 16), 'o': (248, 128, 24), 'y': (255, 214, 70), 'w': (255, 248, 190),
}, '''
    dddddddddddddddd
    dAAAAAdAAAAdAAAd
    dAaaabdAaabdAabd
    dbbbbbdbbbbdbbbd
    dddddddddddddddd
    dAAdkkkkkkkkdAAd
    dAbdkrkkrkkrdabd
    dddddddddddddddd
    dAAdkkkkkkkkdAAd
    dAbkkkkrkkkkkabd
    dddkkrkoorkrkddd
    dAAkrorooyorkAAd
    dabkroyoywyorabd
    dddkroywwwyorddd
    dAbkoyywwyyyokbd
    dddddddddddddddd''')

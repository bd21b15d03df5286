"""A report in German: its sentences, the words of fingerprints and faults, and the labels of pictures."""

from __future__ import annotations

from collections.abc import Mapping

SENTENCES: Mapping[str, str] = {
    "{vessel}; model: {name}": "{vessel}; Modell: {name}",
    "drive train without further elements": "Antriebsstrang ohne weitere Elemente",
    "drive train with {elements}": "Antriebsstrang mit {elements}",
    "ship not named": "Schiff ohne Namen",
    "Skip to the parameters": "Zu den Parametern springen",
    "Contents": "Inhalt",
    "Parameters": "Parameter",
    "Elements that act": "Wirkende Elemente",
    "The speed loop": "Der Drehzahlregelkreis",
    "Signals and model": "Signale und Modell",
    "Frequency responses": "Frequenzgänge",
    "Samples used and left out": "Benutzte und ausgelassene Messwerte",
    "Log quality": "Güte der Aufzeichnung",
    "Sensors and how the signals were made": "Sensoren und wie die Signale entstanden",
    "Statistics": "Statistik",
    "Verdict in full, fits, residual tests": "Vollständiges Urteil, Anpassung, Tests der Residuen",
    "Settings and versions": "Einstellungen und Versionen",
    "versions of the software that made this page": "Versionen der Programme, die diese Seite erzeugt haben",
    "software": "Programm",
    "version": "Version",
    "Structure, settings and seed": "Struktur, Einstellungen und Startwert des Zufalls",
    "No verdict was given.": "Es gibt kein Urteil.",
    "The ship, with intervals of 95 %": "Das Schiff, mit Intervallen von 95 %",
    "The model's figures, not the ship's": "Zahlen des Modells, nicht des Schiffs",
    "What it means for the speed loop": "Was das für den Drehzahlregelkreis heißt",
    "{low} to {high}": "{low} bis {high}",
    "none": "keine",
    "no limit": "keine Grenze",
    "estimate at its lower end": "Schätzwert am unteren Ende",
    "estimate at its upper end": "Schätzwert am oberen Ende",
    "inertia of the whole drive train": "Trägheitsmoment des ganzen Antriebsstrangs",
    "inertia behind the torque gauge": "Trägheitsmoment hinter der Messstelle",
    "{inertia}, seen from the propeller shaft": "{inertia}, auf die Propellerwelle bezogen",
    "at most {high}": "höchstens {high}",
    "may be none": "vielleicht keine",
    "nothing was found that would let the loop swing at higher gains": (
        "nichts gefunden, was den Kreis bei höherer Verstärkung schwingen ließe"
    ),
    "The intervals hold as well for structures that fit as well, and for elements that were not found, each at its limit.": (
        "Die Bereiche gelten auch für Strukturen, die ebenso gut passen, und für nicht gefundene Elemente, jedes an seiner Grenze."
    ),
    "the speed follows the set point up to here": "bis hierher folgt die Drehzahl dem Sollwert",
    "what the gains may grow by before the loop swings": "so viel darf die Verstärkung wachsen, bis der Kreis schwingt",
    "until the speed stays within 5 % of a step of the set point": "bis die Drehzahl nach einem Sollwertsprung auf 5 % genau bleibt",
    "well damped": "gut gedämpft",
    "lively": "lebhaft",
    "close to swinging": "nahe am Schwingen",
    "{name}, {start} to {stop} s: measured, and the model's answer to the same set point.": (
        "{name}, {start} bis {stop} s: gemessen, und die Antwort des Modells auf denselben Sollwert."
    ),
    "A longer record, a larger swing of the set point, a torque channel, or a parameter known from elsewhere would help.": (
        "Es hilft: längere Aufzeichnung, größerer Ausschlag des Sollwerts, ein Drehmomentkanal, ein Parameter aus anderer Quelle."
    ),
    "The figures hold for the model, not for the ship.": "Die Zahlen gelten für das Modell, nicht für das Schiff.",
    "Look where measurement and model part: a channel of another record, a wrong calibration, or a load or limit that the "
    "model lacks.": (
        "Zu prüfen, wo Messung und Modell auseinandergehen: ein Kanal aus einer anderen Aufzeichnung, eine falsche Kalibrierung, "
        "eine Last oder Grenze, die dem Modell fehlt."
    ),
    "These are figures of the model; of the ship they say nothing.": "Dies sind Zahlen des Modells; über das Schiff sagen sie nichts.",
    "Acts: {names}.": "Es wirkt: {names}.",
    "May act or not: {names}.": "Wirkt vielleicht: {names}.",
    "No effect found, either absent or too small to show: {names}.": "Keine Wirkung gefunden, nicht da oder zu schwach: {names}.",
    "Cannot be told: {names}.": "Nicht bestimmbar: {names}.",
    "Known from elsewhere (torsional calculation, factory test), any of {names} would settle it.": (
        "Aus anderer Quelle bekannt (Drehschwingungsrechnung, Prüfstand), würde eines davon es klären: {names}."
    ),
    "More excitation or another signal may.": "Mehr Anregung oder ein weiteres Signal können es klären.",
    "Told only roughly: {names}.": "Nur grob bestimmt: {names}.",
    "Any one of {names}, known from elsewhere (torsional calculation, factory test), would sharpen the others.": (
        "Eines von {names}, aus anderer Quelle bekannt (Drehschwingungsrechnung, Prüfstand), würde die übrigen schärfen."
    ),
    "Nothing is left open: the data tell every parameter that was asked for.": (
        "Nichts bleibt offen: Die Daten bestimmen jeden gesuchten Parameter."
    ),
    "parameters with their 95 % intervals": "Parameter mit ihren 95-%-Bereichen",
    "combinations with their 95 % intervals": "Kombinationen mit ihren 95-%-Bereichen",
    "What the symbols mean": "Was die Zeichen bedeuten",
    "Gains and slopes are normalised: they count changes in per cent of the value at the operating point.": (
        "Verstärkungen und Steigungen sind normiert: Sie zählen Änderungen in Prozent des Werts am Betriebspunkt."
    ),
    "That is an engine speed of {speed} rpm and a torque of {torque} Nm where it was measured.": (
        "Das sind eine Motordrehzahl von {speed} rpm und ein Drehmoment von {torque} Nm, wo es gemessen wurde."
    ),
    "v is the per cent of engine torque that 1 % more fuel rack brings. Speed and torque show the governor's gains K_p and K_i "
    "only as the products vK_p and vK_i; a fuel rack channel would tell v apart.": (
        "v sind die Prozent Motormoment, die 1 % mehr Füllung bringt. Drehzahl und Drehmoment zeigen K_p und K_i des Reglers nur "
        "als Produkte vK_p und vK_i; ein Kanal der Füllung würde v davon trennen."
    ),
    "Combinations": "Kombinationen",
    "Told better than their members, or though these are not told one by one.": (
        "Genauer bestimmt als ihre Glieder, oder obwohl diese einzeln nicht bestimmbar sind."
    ),
    "All estimates as CSV": "Alle Schätzwerte als CSV",
    "the truth that the log was simulated with": "der Wahrheit, mit der die Aufzeichnung simuliert wurde",
    "the estimate": "des Schätzwerts",
    "Estimates with their 95 % intervals, in per cent of {reference}.": (
        "Schätzwerte mit ihren 95-%-Bereichen, in Prozent {reference}."
    ),
    "Red where the interval does not hold the truth.": "Rot, wo der Bereich die Wahrheit nicht enthält.",
    "An arrow: it reaches further.": "Ein Pfeil: Er reicht weiter.",
    "symbol": "Zeichen",
    "name": "Name",
    "estimate": "Schätzwert",
    "std": "Std.-Abw.",
    "95 % interval": "95-%-Bereich",
    "unit": "Einheit",
    "truth": "Wahrheit",
    "formula": "Formel",
    "status": "Stand",
    "The data chose which elements of the ship model act. The bar is what an element buys: how much worse the fit is without "
    "one that acts, how much better with one that does not.": (
        "Die Daten haben gewählt, welche Elemente des Schiffsmodells wirken. Der Balken zeigt, was ein Element bringt: wie viel "
        "schlechter die Anpassung ohne ein wirkendes ist, wie viel besser mit einem, das nicht wirkt."
    ),
    "What each element buys, as the change of the deviance. Left of the line it is no more than chance brings; right of it an "
    "element is taken on, unless the others explain as much once they are fitted with it.": (
        "Was jedes Element bringt, als Änderung der Devianz. Links der Linie ist es nicht mehr, als der Zufall bringt; rechts davon "
        "wird ein Element aufgenommen, wenn nicht die übrigen, mit ihm angepasst, ebenso viel erklären."
    ),
    "elements of the ship model": "Elemente des Schiffsmodells",
    "element": "Element",
    "found": "Befund",
    "change of the deviance": "Änderung der Devianz",
    "change of the deviance [-]": "Änderung der Devianz [-]",
    "limit at 95 %": "Grenze (95 %)",
    "acts": "wirkt",
    "not found to act": "keine Wirkung gefunden",
    "the others explain it": "die übrigen erklären es",
    "cannot be told": "nicht entscheidbar",
    "forced by the user": "vom Benutzer vorgegeben",
    "above": "über",
    "below": "unter",
    "From the model linearised about the operating point, for small motions.": (
        "Aus dem Modell, um den Betriebspunkt linearisiert, für kleine Bewegungen."
    ),
    "Answer to a step of the set point by 1 %; the speed stays within 5 % of the step after the dotted line.": (
        "Antwort auf einen Sollwertsprung von 1 %; nach der punktierten Linie bleibt die Drehzahl auf 5 % des Sprungs genau."
    ),
    "poles, margins and gains of the loop": "Pole, Reserven und Verstärkungen des Kreises",
    "figure": "Größe",
    "note": "Anmerkung",
    "time [s]": "Zeit [s]",
    "{name}: signals, model, and what the model leaves over, against time": "{name}: Signale, Modell und Rest über der Zeit",
    "every sample is in the page": "jeder Messwert steht in der Seite",
    "smallest and largest of every {width} samples ({time} ms) are in the page": (
        "kleinster und größter von je {width} Messwerten ({time} ms) stehen in der Seite"
    ),
    "Drag across to zoom, double-click to see all. With the keyboard: arrows move, + and − zoom, 0 shows all, n and p go from "
    "fault to fault.": (
        "Ziehen vergrößert, Doppelklick zeigt alles. Mit der Tastatur: Pfeile verschieben, + und − vergrößern, 0 zeigt alles, "
        "n und p gehen von Fehler zu Fehler."
    ),
    "model of {name}": "Modell von {name}",
    "{name} − model [{unit}]": "{name} − Modell [{unit}]",
    "{name} less the model": "{name} ohne das Modell",
    "{name}: measured signals and what the fitted model makes of the same set point.": (
        "{name}: gemessene Signale, und was das angepasste Modell aus demselben Sollwert macht."
    ),
    "{name}: signals; masked samples, marked at the bottom, are not fitted.": (
        "{name}: Signale; ausgeblendete Messwerte, unten markiert, gehen nicht in die Anpassung ein."
    ),
    "{name}: measured response to the set point with bars of two standard deviations, and the fitted model's.": (
        "{name}: gemessener Frequenzgang zum Sollwert mit Balken von zwei Standardabweichungen, und der des Modells."
    ),
    "zoom of": "Ausschnitt von",
    "zoom in": "vergrößern",
    "zoom out": "verkleinern",
    "earlier": "früher",
    "later": "später",
    "all": "alles",
    "show all": "alles zeigen",
    "fault": "Fehler",
    "previous fault": "voriger Fehler",
    "next fault": "nächster Fehler",
    "save as CSV": "als CSV sichern",
    "save as PNG": "als PNG sichern",
    "show or hide": "zeigen oder verbergen:",
    "zoomable plot": "Bild mit Ausschnitt",
    "to": "bis",
    "of": "von",
    "at": "bei",
    "time [h:min:s]": "Zeit [h:min:s]",
    "masked": "ausgeblendet",
    "Samples as the logger recorded them; each is counted once. Repaired ones are fitted; cut ones are not, even where "
    "something was put in their place so that the filter passes over them.": (
        "Messwerte, wie sie aufgezeichnet wurden; jeder ist einmal gezählt. Reparierte gehen in die Anpassung ein, "
        "ausgeschnittene nicht, auch wo etwas an ihre Stelle trat, damit das Filter über sie hinwegkommt."
    ),
    "fate of the recorded samples of each channel": "was aus den Messwerten jedes Kanals wurde",
    "channel": "Kanal",
    "log": "Aufzeichnung",
    "recorded": "aufgezeichnet",
    "kept": "behalten",
    "repaired": "repariert",
    "cut": "ausgeschnitten",
    "another sensor used": "anderer Sensor verwendet",
    "outside windows": "außerhalb der Fenster",
    "Samples of the experiments that were cut from the logs, after filtering.": (
        "Messwerte der Versuche, die aus den Aufzeichnungen geschnitten wurden, nach dem Filtern."
    ),
    "samples of each experiment in the fit": "Messwerte jedes Versuchs in der Anpassung",
    "experiment": "Versuch",
    "kind": "Art",
    "length [s]": "Dauer [s]",
    "rate [Hz]": "Rate [Hz]",
    "samples": "Messwerte",
    "fitted": "angepasst",
    "left out": "ausgelassen",
    "why": "warum",
    "{name} masked in {share} %": "{name} zu {share} % ausgeblendet",
    "No fault is on record.": "Es ist kein Fehler verzeichnet.",
    "faults by experiment and channel": "Fehler nach Versuch und Kanal",
    "what was done": "was geschah",
    "count": "Anzahl",
    "a minute": "je Minute",
    "Which samples, counted from each channel's first": "Welche Messwerte, vom ersten jedes Kanals an gezählt",
    " and {rest} more": " und {rest} weitere",
    "pulse trains that the speed was taken from": "Impulsfolgen, aus denen die Drehzahl stammt",
    "pulse train": "Impulsfolge",
    "pulses a turn": "Impulse je Umdrehung",
    "shows speed up to [Hz]": "zeigt die Drehzahl bis [Hz]",
    "trains apart by [%]": "Folgen weichen ab um [%]",
    "reflectors off even places by [%]": "Reflektoren neben gleichmäßigen Plätzen um [%]",
    "{name}: operating point {point}.": "{name}: Betriebspunkt {point}.",
    "How the signals of {name} were made": "Wie die Signale von {name} entstanden",
    "how the signals of {name} were made": "wie die Signale von {name} entstanden",
    "part": "Teil",
    "account": "Bericht",
    "The verdict in full": "Das Urteil im Ganzen",
    "How well the model follows": "Wie gut das Modell folgt",
    "What the data tell apart": "Was die Daten unterscheiden",
    "What the residuals say": "Was die Residuen sagen",
    "The data tell all {free} free parameters apart (condition number of the scaled sensitivities {condition}).": (
        "Die Daten unterscheiden alle {free} freien Parameter (Konditionszahl der skalierten Empfindlichkeiten {condition})."
    ),
    "The data tell {rank} of {free} free parameters apart.": "Die Daten unterscheiden {rank} von {free} freien Parametern.",
    "The model's outputs stay the same when these change together, in the proportion given:": (
        "Die Ausgänge des Modells bleiben gleich, wenn sich diese gemeinsam ändern, im angegebenen Verhältnis:"
    ),
    "Any one of these, known from elsewhere, would settle the rest:": (
        "Jedes davon, aus anderer Quelle bekannt, würde den Rest klären:"
    ),
    "all data": "alle Daten",
    "The model explains {share} % of the variation of the {output} (root mean square), noise included.": (
        "Das Modell erklärt {share} % der Schwankung (Effektivwert, mit Rauschen): {output}."
    ),
    "fit of each output in each experiment": "Anpassung jedes Ausgangs in jedem Versuch",
    "output": "Ausgang",
    "explained [%]": "erklärt [%]",
    "figures of all outputs together": "Kennzahlen aller Ausgänge zusammen",
    "value": "Wert",
    "mean squared error": "mittleres Fehlerquadrat",
    "deviance: minus twice the logarithm of the likelihood": "Devianz: minus zweimal der Logarithmus der Likelihood",
    "final prediction error (FPE)": "Fehler der Vorhersage (FPE)",
    "Akaike's criterion (AIC)": "Kriterium von Akaike (AIC)",
    "Akaike's criterion for few samples (AICc)": "Kriterium von Akaike für wenige Messwerte (AICc)",
    "Bayesian criterion (BIC)": "Bayessches Kriterium (BIC)",
    "consistent Akaike criterion (CAIC)": "konsistentes Kriterium von Akaike (CAIC)",
    "probability of such residuals, were the structure right (p)": (
        "Wahrscheinlichkeit solcher Residuen, wäre die Struktur richtig (p)"
    ),
    "explained by the set point of what was left [%]": "vom Rest durch den Sollwert erklärt [%]",
    "chi-squared": "Chi-Quadrat",
    "degrees of freedom": "Freiheitsgrade",
    "No residual test: what was fitted has no order in time.": (
        "Kein Test der Residuen: Was angepasst wurde, hat keine zeitliche Folge."
    ),
    "What a right model leaves over is noise: unlike the set point, or a dynamic part is missing, and, once whitened, unlike "
    "its own past, or the intervals may be too narrow (Ljung 1999, section 16.6). A test fails below p = {threshold}; on long "
    "records it finds parts that do not matter: the column of what is explained says how much.": (
        "Was ein richtiges Modell übrig lässt, ist Rauschen: dem Sollwert unähnlich, sonst fehlt Dynamik, und geweißt der eigenen "
        "Vergangenheit unähnlich, sonst sind die Bereiche vielleicht zu schmal (Ljung 1999, Abschnitt 16.6). Ein Test schlägt "
        "unter p = {threshold} an; in langen Aufzeichnungen findet er auch Unwichtiges: Die Spalte des Erklärten sagt, wie viel."
    ),
    "residual tests of each output": "Tests der Residuen jedes Ausgangs",
    "set point, p": "Sollwert, p",
    "verdict": "Urteil",
    "explains of what was left [%]": "erklärt vom Rest [%]",
    "whiteness, p": "Weißheit, p",
    "free of the set point": "frei vom Sollwert",
    "follows the set point": "folgt dem Sollwert",
    "white": "weiß",
    "coloured": "farbig",
    "{count} of {lags} lags outside the band": "{count} von {lags} Abständen außerhalb des Bandes",
    "Whitened residuals of the {output}: correlation with their own past, {own}, and with the set point, {by_set_point}. Of "
    "noise one lag in twenty is outside.": (
        "Geweißte Residuen ({output}): Korrelation mit der eigenen Vergangenheit, {own}, und mit dem Sollwert, {by_set_point}. "
        "Bei Rauschen liegt einer von zwanzig außerhalb."
    ),
}
"""English sentence of the report to its German one."""

ELEMENTS: Mapping[str, str] = {
    "dead time in the loop": "Totzeit im Kreis",
    "dead time of the set point": "Totzeit des Sollwerts",
    "lag of the fuel actuator": "Trägheit des Stellglieds",
    "derivative gain": "Differenzialanteil",
    "digital governor that acts every T_s": "digitaler Regler, der alle T_s eingreift",
    "upper torque limit": "obere Momentengrenze",
    "rate limit of the fuel rack": "begrenzte Stellgeschwindigkeit der Füllung",
    "torsionally flexible shaft": "drehelastische Welle",
    "load damping": "Dämpfung der Last",
    "delay of the torque channel": "verspäteter Drehmomentkanal",
    "delay of the speed channel": "verspäteter Drehzahlkanal",
    "measured load torque": "gemessenes Lastmoment",
    "no element": "kein Element",
}

WORDS: Mapping[str, str] = {
    **ELEMENTS,
    "ship": "Schiff",
    "linear": "linear",
    "estimated": "geschätzt",
    "given": "vorgegeben",
    "estimated, with prior": "geschätzt, mit Vorwissen",
    "on its bound": "auf seiner Grenze",
    "not identifiable": "nicht bestimmbar",
    "speed": "Drehzahl",
    "torque": "Drehmoment",
    "integrated speed error": "aufsummierte Drehzahlabweichung",
    "fuel rack": "Füllung",
    "all outputs": "alle Ausgänge",
    "bandwidth": "Bandbreite",
    "crossover": "Durchtrittsfrequenz",
    "phase margin": "Phasenreserve",
    "gain margin": "Amplituden\u00adreserve",
    "recovery time": "Ausregelzeit",
    "overshoot": "Überschwingen",
    "pole 1, real": "Pol 1, Realteil",
    "pole 1, imaginary": "Pol 1, Imaginärteil",
    "pole 2, real": "Pol 2, Realteil",
    "pole 2, imaginary": "Pol 2, Imaginärteil",
    "there is none": "es gibt keine",
    "double crossings (A)": "doppelte Durchgänge (A)",
    "lost pulses (B)": "verlorene Impulse (B)",
    "torque spikes (C)": "Drehmomentspitzen (C)",
    "set-point jumps (D1)": "Sollwertsprünge (D1)",
    "mains hum on the set point (D2)": "Netzbrummen auf dem Sollwert (D2)",
    "chirp of constant frequency (D3)": "Gleitsinus fester Frequenz (D3)",
    "pulses that can't be told from noise": "Impulse, vom Rauschen nicht zu unterscheiden",
    "spikes": "Spitzen",
    "missing samples": "fehlende Messwerte",
    "dropouts to zero": "Aussetzer auf null",
    "stuck channel": "hängender Kanal",
    "clipped": "begrenzt",
    "torque of the other sign": "Drehmoment mit anderem Vorzeichen",
    "rows recorded twice": "doppelt aufgezeichnete Zeilen",
    "jump of the clock, rows missing": "Sprung der Uhr, Zeilen fehlen",
    "clock set back": "Uhr zurückgestellt",
    "clock drift between loggers": "Uhren laufen auseinander",
    "masked samples": "ausgeblendete Messwerte",
    "masked": "ausgeblendet",
    "not fitted": "nicht angepasst",
    "bridged by straight lines": "mit Geraden überbrückt",
    "second crossings removed": "zweite Durchgänge entfernt",
}
"""Words of fingerprints, elements and faults; what is not here stays as it is."""

LABELS: tuple[tuple[str, str], ...] = (
    ("distance from the truth", "Abstand von der Wahrheit"),
    ("distance from the estimate", "Abstand vom Schätzwert"),
    ("with the set point", "mit dem Sollwert"),
    ("residual after the set point", "Residuum nach dem Sollwert"),
    ("set point", "Sollwert"),
    ("engine speed", "Motordrehzahl"),
    ("shaft speed", "Wellendrehzahl"),
    ("shaft torque", "Wellenmoment"),
    ("brake torque", "Motormoment"),
    ("gauge torque", "Messmoment"),
    ("load torque", "Lastmoment"),
    ("speed error", "Drehzahlabweichung"),
    ("integrated error", "aufsummierte Abweichung"),
    ("fuel rack", "Füllung"),
    ("95 % by chance", "95 % durch Zufall"),
    ("95 % band", "95-%-Band"),
    ("autocorrelation", "Autokorrelation"),
    ("measured", "gemessen"),
    ("model", "Modell"),
    ("masked", "ausgeblendet"),
    ("frequency", "Frequenz"),
    ("amplitude ratio", "Amplitudenverhältnis"),
    ("amplitude", "Amplitude"),
    ("phase", "Phase"),
    ("within", "innerhalb"),
    ("outside", "außerhalb"),
    ("samples", "Messwerte"),
    ("speed", "Drehzahl"),
    ("torque", "Drehmoment"),
    ("lag", "Abstand"),
    ("time", "Zeit"),
)
"""Words of axes and legends, the longer ones first."""
